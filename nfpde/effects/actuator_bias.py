"""A constant added to a command."""

import math

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales


@register
class ActuatorBias(Effect):
    """An offset of the command: amplifier offset, a zero that drifted, a wrong calibration of a servo."""

    name = "actuator_bias"
    kind = "actuator"
    quantities = (Quantity("offset", "ctrl unit", -math.inf, math.inf, neutral=0.0),)
    sentence = "The actuator acts as if its command had a constant added."
    confounders = ("joint_offset", "gravity_tilt", "payload", "joint_spring")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to the typical size of its command, to both sides."""
        if element < 0:
            return None
        size = float(scales.ctrl[model.actuator_ctrladr[element]])
        return {"offset": (-size, size)}

    def command(self, ctrl: Array, values: Array, timestep: float) -> Array:
        """Add the offset; MuJoCo clamps the sum to ctrlrange as it clamps every command."""
        out = ctrl.copy()
        out[:, :, self.ctrls] += values[:, :1, None]
        return out

    def screened(self, scales: DataScales) -> Array:
        """A small and a large offset."""
        most = self.parameters[0].high
        return np.array([[share * most] for share in (0.03, 0.2)])
