"""Actuators that give more or less than they are asked for."""

from typing import ClassVar

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales


@register
class MotorStrength(Effect):
    """All that an actuator does, times a factor: MuJoCo's `actuator_gainprm` and `actuator_biasprm`, scaled.

    For a servo both its gain and its damping change, as with a motor of another torque constant behind the same
    controller. Limits of the force stay as they are.
    """

    name = "motor_strength"
    kind = "actuator"
    quantities = (Quantity("scale", "-", 0.0, 10.0, neutral=1.0),)
    default_bounds: ClassVar[Bounds] = {"scale": (0.3, 1.7)}
    sentence = "The motor gives a fixed share of the torque that the model expects: torque constant, voltage, wear."
    confounders = ("armature", "payload", "servo_gain", "viscous_damping")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """From a third to nearly twice the strength, on one actuator."""
        return dict(cls.default_bounds) if element >= 0 else None

    def screened(self, scales: DataScales) -> Array:
        """Weaker by a little and by much."""
        return np.array([[0.95], [0.7]])

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Scale gain and bias."""
        model.actuator_gainprm[self.ids] *= values[0]
        model.actuator_biasprm[self.ids] *= values[0]
