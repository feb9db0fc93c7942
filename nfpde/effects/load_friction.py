"""Friction that grows with the load on a gear."""

from __future__ import annotations

import math
from typing import Self

import mujoco
import numpy as np

from nfpde.effects.drive import DRIVE_FIELDS, Drives, driven_joint, is_plain
from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows, World
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_axis
from nfpde.errors import BadEffect


@register
class LoadFriction(Effect):
    """Dry friction of base + share |torque that the actuators transmit to the joint|.

    MuJoCo's `dof_frictionloss` is set before every physics step from the commands and the state at its start, so that
    sticking and reversal stay with MuJoCo's own constraint solver.

    Reference: Duclusaud, Passault, Padois, Ly, Extended Friction Models for the Physics Simulation of Servo
    Actuators, 2024.
    """

    name = "load_friction"
    kind = "joint"
    quantities = (
        Quantity("base", "Nm", 0.0, math.inf, neutral=0.0),
        Quantity("share", "-", 0.0, 2.0, neutral=0.0),
    )
    taken_fields = ("actuator_ctrlrange",)
    step_fields = ("dof_frictionloss", *DRIVE_FIELDS)
    step_order = 2  # a rotor that is free in its play transmits nothing to its joint
    sentence = "The gear rubs more the more torque it transmits."
    confounders = ("coulomb_friction", "stribeck_friction", "motor_strength")

    drives: Drives

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to three times the typical force, and nine tenths of the torque, of a joint that an actuator drives."""
        if not is_axis(model, element) or not _drivers(model, np.array([element])):
            return None
        return {"base": (0.0, 3 * float(scales.force[model.jnt_dofadr[element]])), "share": (0.0, 0.9)}

    def screened(self, scales: DataScales) -> Array:
        """A share alone, small to large, and with some friction at no load."""
        most = self.parameters[0].high
        margin = 1e-6 * most
        top = self.parameters[1].high
        return np.array([[margin + b * most, s * top] for b, s in ((0, 0.05), (0, 0.2), (0, 0.5), (0.05, 0.2))])

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: a joint that no motor or servo drives.
        """
        bound = super().bind(model)
        ids = _drivers(model, bound.ids)
        bound.drives = Drives.of(model, np.array(ids, dtype=np.intp), self.name)
        idle = set(bound.ids.tolist()) - set(bound.drives.joints.tolist())
        if idle:
            raise BadEffect(
                f"{self.name} on {self.target!r}: no motor or servo drives joint #{min(idle)}, so it transmits no "
                "torque; use coulomb_friction there"
            )
        return bound

    def actuators(self) -> Rows:
        """See `Effect.actuators`; those that drive its joints."""
        return self.drives.ids

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Add the friction that belongs to the torque of this step."""
        torque = self.drives.torque_together(world, rows, self.ids)
        world.fields["dof_frictionloss"][np.ix_(rows, self.dofs)] += values[:, :1] + values[:, 1:] * np.abs(torque)


def _drivers(model: mujoco.MjModel, joints: Rows) -> list[int]:
    """Plain actuators on these joints."""
    wanted = set(joints.tolist())
    return [i for i in range(model.nactuator) if is_plain(model, i) and driven_joint(model, i) in wanted]
