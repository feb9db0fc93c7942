"""A centre of mass that is not where the model has it."""

import math

import mujoco
import numpy as np

from nfpde.effects.bodies import is_simple, moves, reach
from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales


@register
class ComShift(Effect):
    """The centre of mass of a body, moved in the body's frame: MuJoCo's `body_ipos`, the inertia about it unchanged."""

    name = "com_shift"
    kind = "body"
    quantities = tuple(Quantity(f"shift_{axis}", "m", -math.inf, math.inf, neutral=0.0) for axis in "xyz")
    sentence = "The body's weight sits elsewhere than in the model: batteries, cables, another tool."
    confounders = ("payload", "gravity_tilt", "external_force")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to the body's size; not where MuJoCo compiled the body as simple."""
        if not moves(model, element) or is_simple(model, element):
            return None
        far = reach(model, element)
        return {f"shift_{axis}": (-far, far) for axis in "xyz"}

    def screened(self, scales: DataScales) -> Array:
        """Some way along every axis."""
        far = self.parameters[0].high
        return 0.15 * far * np.eye(3)

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Move the centre."""
        model.body_ipos[self.ids] += values
