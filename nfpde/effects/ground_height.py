"""Height of the ground."""

from __future__ import annotations

import math
from typing import Self

import mujoco
import numpy as np

from nfpde.effects.contacts import Index, touching
from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.errors import BadEffect


@register
class GroundHeight(Effect):
    """The geoms of the world that the robot can touch, raised: MuJoCo's `geom_pos`, added to."""

    name = "ground_height"
    kind = None
    whole = "contact"
    quantities = (Quantity("height", "m", -math.inf, math.inf, neutral=0.0),)
    sentence = "The ground lies higher or lower than in the model, or the legs are longer or shorter."
    confounders = ("contact_softness", "joint_offset")
    ground: Index
    up: Array
    """The vertical in the frames of the bodies that the ground's geoms belong to, (n, 3)."""

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """A fifth of the robot's size up or down, where anything can touch the world."""
        ground, robot, _ = touching(model)
        far = 0.2 * scales.length
        return {"height": (-far, far)} if len(ground) and len(robot) else None

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: nothing can touch the world.
        """
        bound = super().bind(model)
        bound.ground = touching(model)[0]
        if not len(bound.ground):
            raise BadEffect(f"{self.name}: nothing in this model can touch the world")
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        frames = data.xmat[model.geom_bodyid[bound.ground]].reshape(-1, 3, 3)
        bound.up = frames[:, 2]
        return bound

    def screened(self, scales: DataScales) -> Array:
        """A little and more, up and down: contacts are no mirror images."""
        far = self.parameters[0].high
        return far * np.array([[0.006], [0.03], [-0.006], [-0.03]])

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Raise the ground."""
        if values[0]:
            model.geom_pos[self.ground] += values[0] * self.up
