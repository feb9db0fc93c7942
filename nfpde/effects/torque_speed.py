"""Motors that give less torque the faster they turn."""

from __future__ import annotations

import math
from typing import Self

import mujoco
import numpy as np

from nfpde.effects.drive import driven_joint, driven_joints, torque_scales
from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows, World
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import joint_dofs

_FREE = 1e12
"""A speed, or a torque, that nothing reaches."""

_ABOVE = 15.0
"""The largest torque at rest that is tried, in largest torques: a steep line matters at speed only."""


@register
class TorqueSpeed(Effect):
    """The torque-speed line of an electric motor, at the joint.

    Against the motion the motor gives up to `stall_torque`; with the motion at most
    stall_torque (1 - |speed| / no_load_speed), and nothing from `no_load_speed` on. Before every physics step
    MuJoCo's `jnt_actfrcrange`, which acts behind the gear, is tightened to that; several actuators of one joint are
    limited together.
    """

    name = "torque_speed"
    kind = "actuator"
    quantities = (
        Quantity("no_load_speed", "rad/s", 1e-9, math.inf, neutral=_FREE, log=True),
        Quantity("stall_torque", "Nm", 0.0, math.inf, neutral=_FREE, log=True),
    )
    step_fields = ("jnt_actfrcrange",)
    step_order = -1
    threshold = True
    sentence = "The motor gives less torque the faster it turns, and none beyond its no-load speed."
    confounders = ("torque_limit", "viscous_damping", "motor_strength")

    joints: Rows

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """From half the typical speed and a third of the typical torque at the joint to many times them."""
        joint = driven_joint(model, element)
        if joint < 0:
            return None
        torque, peak = torque_scales(model, element, scales)
        speed = float(scales.speed[model.jnt_dofadr[joint]])
        if torque <= 0 or speed <= 0:
            return None
        return {"no_load_speed": (0.5 * speed, 20 * speed), "stall_torque": (0.3 * torque, _ABOVE * peak)}

    def screened(self, scales: DataScales) -> Array:
        """Lines that cut off much and little, by the speed and by the torque, the last of the largest torque alone."""
        low, high = (np.array([getattr(p, side) for p in self.parameters]) for side in ("low", "high"))
        speed, torque, peak = high[0] / 20, low[1] / 0.3, high[1] / _ABOVE
        pairs = ((1.5, 3.0), (3.0, 3.0), (1.5, 10.0), (3.0, 10.0), (8.0, 1.5), (8.0, 0.8), (8.0, peak / torque))
        return np.clip([[v * speed, t * torque] for v, t in pairs], 1.01 * low, 0.99 * high)

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: an actuator that acts on no hinge or slide.
        """
        bound = super().bind(model)
        bound.joints = driven_joints(model, bound.ids, f"{self.name} on {self.target!r}")
        bound.dofs = joint_dofs(model, bound.joints)
        return bound

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Have MuJoCo limit the joint's actuator forces at all."""
        if not self.active(values[None])[0]:
            return
        free = [j for j in self.joints if not model.jnt_actfrclimited[j]]
        model.jnt_actfrclimited[free] = 1
        model.jnt_actfrcrange[free] = (-_FREE, _FREE)

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Tighten the range to what the motor gives at the current speed."""
        top, stall = values[:, :1], values[:, 1:]
        speed = world.qvel[np.ix_(rows, self.dofs)]
        cell = np.ix_(rows, self.joints)
        limits = world.fields["jnt_actfrcrange"]
        most = stall * np.clip(1 - np.clip(speed, 0, None) / top, 0, None)
        least = -stall * np.clip(1 + np.clip(speed, None, 0) / top, 0, None)
        own = limits[cell]
        limits[cell] = np.stack([np.maximum(own[..., 0], least), np.minimum(own[..., 1], most)], axis=-1)
