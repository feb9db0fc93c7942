"""Servos with other gains than the model's."""

from __future__ import annotations

from typing import ClassVar, Self

import mujoco
import numpy as np

from nfpde.effects.drive import is_servo, is_speed_servo
from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.errors import BadEffect


@register
class ServoGain(Effect):
    """The gains of a position or velocity servo times factors: MuJoCo's `actuator_gainprm` and `actuator_biasprm`.

    A position servo gives kp (ctrl - position) - kv speed, a velocity servo kv (ctrl - speed), so that a velocity
    servo has no kp to scale. Limits of the force stay as they are.
    """

    name = "servo_gain"
    kind = "actuator"
    quantities = (
        Quantity("kp_scale", "-", 0.0, 100.0, neutral=1.0, log=True),
        Quantity("kv_scale", "-", 0.0, 100.0, neutral=1.0, log=True),
    )
    default_bounds: ClassVar[Bounds] = {"kp_scale": (0.2, 5.0), "kv_scale": (0.2, 5.0)}
    sentence = "The servo's controller is softer or stiffer, less or more damped, than the model's."
    confounders = ("motor_strength", "viscous_damping", "joint_spring", "payload")

    positions: Rows
    speeds: Rows

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """From a fifth of the gains to five times them, on one position or velocity servo."""
        fits = element >= 0 and (is_servo(model, element) or is_speed_servo(model, element))
        return dict(cls.default_bounds) if fits else None

    def screened(self, scales: DataScales) -> Array:
        """Each gain alone, a little softer and much stiffer."""
        factors = (0.85, 1.8)
        rows = np.array([*((f, 1.0) for f in factors), *((1.0, f) for f in factors)])
        low, high = (np.array([getattr(p, side) for p in self.parameters]) for side in ("low", "high"))
        margin = 1e-6 * (high - low)
        return np.clip(rows, low + margin, high - margin)

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: an actuator that is no position or velocity servo.
        """
        bound = super().bind(model)
        bound.positions = np.array([i for i in bound.ids if is_servo(model, int(i))], dtype=np.intp)
        bound.speeds = np.array([i for i in bound.ids if is_speed_servo(model, int(i))], dtype=np.intp)
        if len(bound.positions) + len(bound.speeds) < len(bound.ids):
            raise BadEffect(
                f"{self.name} on {self.target!r}: it needs position or velocity servos on hinges or slides, "
                "name the ones you mean"
            )
        return bound

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Scale gains and biases."""
        kp, kv = values
        model.actuator_gainprm[self.positions, 0] *= kp
        model.actuator_biasprm[self.positions, 1] *= kp
        model.actuator_biasprm[self.positions, 2] *= kv
        model.actuator_gainprm[self.speeds, 0] *= kv
        model.actuator_biasprm[self.speeds, 2] *= kv
