"""Faults for which a diagnosis has no name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from nfpde.bench.gap.faults.base import Array, Fault, dof_of
from nfpde.bench.gap.faults.friction import DryFriction

if TYPE_CHECKING:
    from nfpde.bench.gap.plant import Plant


class _AngleTorque(Fault, ABC):
    """A torque that depends on the joint's angle alone."""

    @abstractmethod
    def law(self, angle: float) -> float:
        """The torque [Nm] at an angle [rad]."""

    def push(self, plant: Plant) -> None:
        """Exert it."""
        angle = float(plant.data.qpos[plant.model.joint(self.target).qposadr[0]])
        plant.data.qfrc_applied[dof_of(plant.model, self.target)] += self.law(angle)


class Cogging(_AngleTorque):
    """The rotor's magnets like some angles more than others."""

    def law(self, angle: float) -> float:
        """A sine of the angle, `teeth` times a turn."""
        return self.values["torque"] * float(np.sin(self.values["teeth"] * angle))


class Magnet(_AngleTorque):
    """Something magnetic beside the joint pulls it to one angle from nearby."""

    def law(self, angle: float) -> float:
        """Strongest one `width` away, nothing far away."""
        x = (angle - self.values["angle"]) / self.values["width"]
        return -self.values["torque"] * x * float(np.exp(0.5 - x * x / 2))


class LooseCable(_AngleTorque):
    """A cable that hangs slack up to an angle and pulls back beyond it."""

    def law(self, angle: float) -> float:
        """A spring on one side only."""
        return -self.values["stiffness"] * max(angle - self.values["angle"], 0.0)


class Repulsion(_AngleTorque):
    """An over-centre mechanism: pushed away from the middle, up to a reach."""

    def law(self, angle: float) -> float:
        """A spring of negative stiffness that fades out."""
        x = angle - self.values["angle"]
        return self.values["stiffness"] * x * float(np.exp(-((x / self.values["reach"]) ** 2)))


class SeizingUp(DryFriction):
    """A bearing that runs freely at first and rubs with its full torque later in each episode."""

    def begin(self, plant: Plant, ctrl: Array) -> None:
        """It begins between 1.5 and 2 s, later than anything that a window of an effect at a time would show."""
        self.memory = {"from": 1.75}

    def budget(self, plant: Plant, dof: int) -> float:
        """Grows within half a second."""
        share = float(np.clip((plant.data.time - self.memory["from"]) / 0.5, 0, 1))
        return self.values["torque"] * share


class Sloshing(Fault):
    """A load that swings in the body: a weight on a rod of `length` from a ball joint, hidden from all sensors.

    The model has the load as a rigid part of the body, so that nothing changes at rest. The weight is simulated beside
    the robot: two horizontal coordinates of a damped pendulum whose pivot is the body's centre of mass.
    """

    def alter(self, model: mujoco.MjModel) -> None:
        """Take the load off the body."""
        model.body_mass[model.body(self.target).id] -= self.values["mass"]

    def begin(self, plant: Plant, ctrl: Array) -> None:
        """Hanging still."""
        self.memory = {"place": np.zeros(3), "speed": np.zeros(3), "pivot_speed": None}

    def push(self, plant: Plant) -> None:
        """Move the weight in the pivot's frame; the body carries its weight and what swinging asks for."""
        data, model, memory = plant.data, plant.model, self.memory
        body = model.body(self.target).id
        mass, length, dt = self.values["mass"], self.values["length"], model.opt.timestep
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, int(mujoco.mjtObj.mjOBJ_XBODY), body, velocity, 0)
        offset = data.xipos[body] - data.xpos[body]
        pivot = velocity[3:] + np.cross(velocity[:3], offset)
        last = memory["pivot_speed"]
        pull = np.zeros(3) if last is None else np.clip((pivot - last) / dt, -60, 60)
        gravity = -model.opt.gravity[2]
        pulled = -gravity / length * memory["place"] - pull * (1, 1, 0) - 0.6 * memory["speed"]
        memory["speed"] = memory["speed"] + dt * pulled
        memory["place"] = memory["place"] + dt * memory["speed"]
        memory["pivot_speed"] = pivot
        tension = mass * gravity / length * memory["place"]
        data.xfrc_applied[body, :3] += tension + np.array([0, 0, -mass * gravity])
