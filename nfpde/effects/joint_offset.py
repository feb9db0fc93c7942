"""Encoders whose zero is off."""

import math
from typing import Self

import mujoco
import numpy as np

from nfpde.effects.drive import refuse_unread, servos_on, unread_on
from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_axis
from nfpde.errors import BadEffect


@register
class JointOffset(Effect):
    """The measured position of a joint is the true one plus an offset.

    A servo of the joint reads the same encoder, so it settles where the measured position is right.
    """

    name = "joint_offset"
    kind = "joint"
    quantities = (Quantity("offset", "rad", -math.inf, math.inf, neutral=0.0),)
    write_order = 1  # a servo's gain times its reading
    sentence = "The zero of the joint's encoder is off: the recorded position is the true one plus a constant."
    confounders = ("gravity_tilt", "actuator_bias", "com_shift", "joint_spring")

    servos: Rows

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """To both sides: twice the joint's spread, at least half a radian or a tenth of the robot, at most pi/2."""
        if not is_axis(model, element) or (cls._in_loop() and unread_on(model, np.array([element]))):
            return None
        spread = 2 * float(scales.position[model.jnt_dofadr[element]])
        hinge = int(model.jnt_type[element]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        size = min(max(spread, 0.5), 0.5 * math.pi) if hinge else max(spread, 0.1 * scales.length)
        return {"offset": (-size, size)}

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: a joint that is no hinge or slide, or one whose sensor something reads that is no servo.
        """
        bound = super().bind(model)
        if not all(is_axis(model, int(j)) for j in bound.ids):
            raise BadEffect(f"{self.name} on {self.target!r}: it needs hinges or slides, name the ones you mean")
        bound.servos = servos_on(model, bound.ids)
        if self._in_loop():
            refuse_unread(model, bound.ids, f"{self.name} on {self.target!r}", "joint_offset_logged")
        return bound

    @classmethod
    def _in_loop(cls) -> bool:
        """Whether servos act on the wrong reading, too, and not on the true one as in other readings of the effect."""
        return cls.write_model is JointOffset.write_model

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Let servos act on the measured position."""
        reading = model.actuator_gear[self.servos, 0] * values[0]
        model.actuator_biasprm[self.servos, 0] += model.actuator_biasprm[self.servos, 1] * reading

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
