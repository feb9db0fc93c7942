"""A constant push or pull on a body."""

import math

import mujoco
import numpy as np

from nfpde.effects.bodies import moves
from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows, World
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales


@register
class ExternalForce(Effect):
    """A constant force at a body's centre of mass, in the world's frame: MuJoCo's `xfrc_applied`."""

    name = "external_force"
    kind = "body"
    quantities = tuple(Quantity(f"force_{axis}", "N", -math.inf, math.inf, neutral=0.0) for axis in "xyz")
    sentence = "Something pulls or pushes at the body with a constant force: a tether, a cable, a leaning load."
    confounders = ("payload", "gravity_tilt", "wind", "actuator_bias")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to twice the weight of all that moves."""
        if not moves(model, element):
            return None
        weight = 9.81 * float(model.body_subtreemass[model.body_rootid[element]])
        return {f"force_{axis}": (-2 * weight, 2 * weight) for axis in "xyz"}

    def screened(self, scales: DataScales) -> Array:
        """Some along every axis."""
        most = self.parameters[0].high
        return 0.03 * most * np.eye(3)

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Push."""
        world.xfrc_applied[np.ix_(rows, self.ids, np.arange(3))] += values[:, None, :]
