"""A limit of the torque that an actuator brings to its joint."""

from __future__ import annotations

import math
from typing import Self

import mujoco
import numpy as np

from nfpde.effects.drive import driven_joint, driven_joints, torque_scales
from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales

_FREE = 1e12
"""A limit that nothing reaches."""

_ABOVE = 4.0
"""The highest limit that is tried, in largest torques: nothing would reach it, were the model right."""

_BELOW = 0.02
"""The lowest, in typical torques: a servo that is far from its goal asks for many times what its motor has."""

_MUCH = 0.5
"""The lowest that is screened, in typical torques."""


@register
class TorqueLimit(Effect):
    """The torque at the joint stays below a limit: MuJoCo's `jnt_actfrcrange`, which acts behind the gear.

    Several actuators of one joint are limited together.
    """

    name = "torque_limit"
    kind = "actuator"
    quantities = (Quantity("limit", "Nm", 0.0, math.inf, neutral=_FREE, log=True),)
    threshold = True
    sentence = "The motor or its electronics cut the torque off at a limit."
    confounders = ("torque_speed", "motor_strength", "dead_zone")
    joints: Rows

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """From next to none of the typical torque at the joint to several times the largest."""
        if element < 0 or driven_joint(model, element) < 0:
            return None
        typical, peak = torque_scales(model, element, scales)
        return {"limit": (_BELOW * typical, _ABOVE * peak)} if typical > 0 else None

    def screened(self, scales: DataScales) -> Array:
        """Limits from one that cuts off much, always, to one that cuts off little of the largest torque, seldom."""
        low, high = self.parameters[0].low, self.parameters[0].high
        return np.geomspace(_MUCH / _BELOW * low, 0.95 / _ABOVE * high, 6)[:, None]

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`; the actuators must act on joints with a limited force range or none.

        Raises:
            BadEffect: an actuator that acts on no hinge or slide.
        """
        bound = super().bind(model)
        bound.joints = driven_joints(model, bound.ids, f"{self.name} on {self.target!r}")
        return bound

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Tighten the range of actuator forces of the joint."""
        limit = float(values[0])
        if limit >= _FREE:
            return
        limited = model.jnt_actfrclimited[self.joints].astype(bool)[:, None]
        own = np.where(limited, model.jnt_actfrcrange[self.joints], [-np.inf, np.inf])
        model.jnt_actfrcrange[self.joints] = np.clip(own, -limit, limit)
        model.jnt_actfrclimited[self.joints] = 1
