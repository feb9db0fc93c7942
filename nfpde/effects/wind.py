"""Wind."""

import math

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales

AIR = 1.2
"""Density of air [kg/m3], for a model that has no medium for a wind to blow in."""


@register
class Wind(Effect):
    """A steady wind, in the world's frame: MuJoCo's `opt.wind`, in a medium of the model's density, or else of air.

    Without wind nothing changes, not even the density.
    """

    name = "wind"
    kind = None
    whole = "world"
    quantities = tuple(Quantity(f"velocity_{axis}", "m/s", -math.inf, math.inf, neutral=0.0) for axis in "xyz")
    sentence = "A steady wind blows on the robot."
    confounders = ("external_force", "gravity_tilt", "fluid_drag")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to a storm."""
        return {f"velocity_{axis}": (-30.0, 30.0) for axis in "xyz"}

    def screened(self, scales: DataScales) -> Array:
        """A fresh wind along every axis."""
        return 8.0 * np.eye(3)

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Let it blow."""
        if not values.any():
            return
        model.opt.wind[:] += values
        if model.opt.density == 0.0:
            model.opt.density = AIR
