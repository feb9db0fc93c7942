"""Encoders that count too much or too little."""

from __future__ import annotations

from typing import ClassVar, Self

import mujoco
import numpy as np

from nfpde.effects.drive import refuse_unread, servos_on, unread_on
from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_axis
from nfpde.errors import BadEffect


@register
class SensorScale(Effect):
    """The measured position and speed of a joint are the true ones times a scale.

    A servo of the joint reads the same sensor.
    """

    name = "sensor_scale"
    kind = "joint"
    quantities = (Quantity("scale", "-", 1e-3, 1e3, neutral=1.0, log=True),)
    default_bounds: ClassVar[Bounds] = {"scale": (0.6, 1.7)}
    write_order = 1  # a servo's gain times its reading
    sentence = "The joint's sensor reports a fixed multiple of the motion: a wrong gear ratio or calibration."
    confounders = ("motor_strength", "time_scale", "joint_offset")

    read: Rows
    """Where in a state what the sensor reports stands: positions, then speeds."""
    servos: Rows

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """From 0.6 to 1.7 times, on one hinge or slide."""
        if not is_axis(model, element) or (cls._in_loop() and unread_on(model, np.array([element]))):
            return None
        return dict(cls.default_bounds)

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: a joint that is no hinge or slide, or one whose sensor something reads that is no servo.
        """
        bound = super().bind(model)
        if not all(is_axis(model, int(j)) for j in bound.ids):
            raise BadEffect(f"{self.name} on {self.target!r}: it needs hinges or slides, name the ones you mean")
        bound.read = np.concatenate([bound.qposadr, model.nq + bound.dofs])
        bound.servos = servos_on(model, bound.ids)
        if self._in_loop():
            refuse_unread(model, bound.ids, f"{self.name} on {self.target!r}", "sensor_scale_logged")
        return bound

    @classmethod
    def _in_loop(cls) -> bool:
        """Whether servos act on the wrong reading, too, and not on the true one as in other readings of the effect."""
        return cls.write_model is SensorScale.write_model

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Let servos act on the measured position and speed."""
        model.actuator_biasprm[self.servos, 1:3] *= values[0]

    def to_simulated(self, state: Array, values: Array) -> Array:
        """Divide what is reported by the scale."""
        out = np.array(state)
        out[..., self.read] /= values
        return out

    def to_measured(self, state: Array, values: Array) -> Array:
        """Multiply what is reported by the scale."""
        out = np.array(state)
        out[..., self.read] *= values
        return out
