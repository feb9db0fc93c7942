"""Faults of joints and bodies: springs, dampers, rotor inertia, loads, centres of mass, forces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from nfpde.bench.gap.faults.base import Fault, dof_of

if TYPE_CHECKING:
    from nfpde.bench.gap.plant import Plant


class Grease(Fault):
    """Stiff grease: damping on top of the model's."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Add it."""
        model.dof_damping[dof_of(model, self.target)] += self.values["damping"]


class Spring(Fault):
    """A hose or cable that pulls the joint to a rest position."""

    def push(self, plant: Plant) -> None:
        """Hooke's law."""
        q = plant.data.qpos[plant.model.joint(self.target).qposadr[0]]
        pull = -self.values["stiffness"] * (q - self.values["rest"])
        plant.data.qfrc_applied[dof_of(plant.model, self.target)] += pull


class RotorInertia(Fault):
    """A heavier rotor than documented."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Add it to the joint's armature."""
        model.dof_armature[dof_of(model, self.target)] += self.values["inertia"]


class Payload(Fault):
    """Something small and heavy sits at `position` in the frame of the body."""

    RADIUS = 0.012

    def build(self, spec: mujoco.MjSpec) -> None:
        """Weld a small ball to the body."""
        mass = self.values["mass"]
        ball = spec.body(self.target).add_body(name="stowaway", pos=list(self.values["position"]))
        ball.explicitinertial = True
        ball.mass, ball.ipos = mass, [0, 0, 0]
        ball.inertia = [0.4 * mass * self.RADIUS**2] * 3


class MassMoved(Fault):
    """The body's centre of mass is elsewhere: `shift` in the body's frame."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Move it; the inertia about it stays."""
        model.body_ipos[model.body(self.target).id] += self.values["shift"]


class SteadyForce(Fault):
    """A constant force on the body's centre of mass, in the world's axes: a rope and a weight."""

    def push(self, plant: Plant) -> None:
        """Pull."""
        plant.data.xfrc_applied[plant.model.body(self.target).id, :3] += np.asarray(self.values["force"])
