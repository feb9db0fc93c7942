"""Encoders whose zero is off."""

import math
from typing import Self

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_axis
from nfpde.errors import BadEffect


@register
class JointOffset(Effect):
    """The measured position of a joint is the true one plus an offset.

    What a servo feeds back is taken to be the true position: the offset is one of the recording.
    """

    name = "joint_offset"
    kind = "joint"
    quantities = (Quantity("offset", "rad", -math.inf, math.inf, neutral=0.0),)
    sentence = "The zero of the joint's encoder is off: the recorded position is the true one plus a constant."
    confounders = ("gravity_tilt", "actuator_bias", "com_shift", "joint_spring")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """To both sides: twice the joint's spread, at least half a radian or a tenth of the robot, at most pi/2."""
        if not is_axis(model, element):
            return None
        spread = 2 * float(scales.position[model.jnt_dofadr[element]])
        hinge = int(model.jnt_type[element]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        size = min(max(spread, 0.5), 0.5 * math.pi) if hinge else max(spread, 0.1 * scales.length)
        return {"offset": (-size, size)}

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: a joint that is no hinge or slide.
        """
        bound = super().bind(model)
        if not all(is_axis(model, int(j)) for j in bound.ids):
            raise BadEffect(f"{self.name} on {self.target!r}: it needs hinges or slides, name the ones you mean")
        return bound

    def to_simulated(self, state: Array, values: Array) -> Array:
        """Take the offset off the positions."""
        out = np.array(state)
        out[..., self.qposadr] -= values
        return out

    def to_measured(self, state: Array, values: Array) -> Array:
        """Add the offset to the positions."""
        out = np.array(state)
        out[..., self.qposadr] += values
        return out
