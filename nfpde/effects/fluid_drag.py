"""Drag of the air or of water."""

import math

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales


@register
class FluidDrag(Effect):
    """A medium that resists motion: MuJoCo's `opt.density` and `opt.viscosity`, added to."""

    name = "fluid_drag"
    kind = None
    whole = "world"
    quantities = (
        Quantity("density", "kg/m3", 0.0, 2000.0, neutral=0.0),
        Quantity("viscosity", "Pa s", 0.0, math.inf, neutral=0.0),
    )
    write_order = 1  # added to the air that a wind puts into a model without a medium
    sentence = "The medium around the robot resists its motion, with the square of the speed and in proportion to it."
    confounders = ("viscous_damping", "wind")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to what would balance the typical forces at typical speeds of a body of the robot's size."""
        ends = float(np.median(scales.speed)) * scales.length
        force = float(np.median(scales.force)) / scales.length
        area = (0.3 * scales.length) ** 2
        density = min(2000.0, 100.0 * force / (0.5 * area * ends**2))
        return {"density": (0.0, density), "viscosity": (0.0, 100.0 * force / (scales.length * ends))}

    def screened(self, scales: DataScales) -> Array:
        """Thin and thick, by density and by viscosity."""
        density, viscosity = (p.high for p in self.parameters)
        shares = (0.001, 0.01, 0.1)
        return np.array(
            [[s * density, 1e-6 * viscosity] for s in shares] + [[1e-6 * density, s * viscosity] for s in shares]
        )

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Add to the medium."""
        model.opt.density += values[0]
        model.opt.viscosity += values[1]
