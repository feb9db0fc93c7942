"""Friction between the robot and the world."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, Self

import mujoco
import numpy as np

from nfpde.effects.contacts import Index, touching
from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.errors import BadEffect


@register
class GroundFriction(Effect):
    """The sliding coefficient of every contact between the robot and the world: `geom_friction`, set.

    A contact takes the larger coefficient of its two geoms, so both sides are set: the world's to the value, the
    robot's to no more. Neutral is what the model has.
    """

    name = "ground_friction"
    kind = None
    whole = "contact"
    quantities = (Quantity("sliding", "-", 0.0, math.inf, neutral=1.0, log=True),)
    sentence = "The ground is more or less slippery than in the model."
    confounders = ("contact_softness",)
    default_bounds: ClassVar[Bounds] = {"sliding": (0.05, 3.0)}
    ground: Index
    robot: Index
    pairs: Index

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """From ice to three times the model's coefficient, where anything can touch the world."""
        ground, robot, _ = touching(model)
        return {"sliding": (0.05, max(3.0, 3 * _own(model)))} if len(ground) and len(robot) else None

    @classmethod
    def candidates(cls, model: mujoco.MjModel, scales: DataScales) -> list[Effect]:
        """The effect, bound: its neutral value is the model's own."""
        return [e.bind(model) for e in super().candidates(model, scales)]

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: nothing can touch the world.
        """
        bound = super().bind(model)
        bound.ground, bound.robot, bound.pairs = touching(model)
        if not len(bound.ground) or not len(bound.robot):
            raise BadEffect(f"{self.name}: nothing in this model can touch the world")
        bound.quantities = (replace(self.quantities[0], neutral=_own(model)),)
        return bound

    def screened(self, scales: DataScales) -> Array:
        """More slippery and less."""
        own, p = self.quantities[0].neutral, self.parameters[0]
        return np.clip(own * np.array([[0.2], [0.5], [0.8], [1.25], [2.0]]), 1.001 * p.low, 0.999 * p.high)

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Set both sides of every contact with the world."""
        value = float(values[0])
        if value == self.quantities[0].neutral:
            return
        model.geom_friction[self.ground, 0] = value
        model.geom_friction[self.robot, 0] = np.minimum(model.geom_friction[self.robot, 0], value)
        model.pair_friction[self.pairs, :2] = value


def _own(model: mujoco.MjModel) -> float:
    """The model's coefficient: the larger of both sides; of several geoms the median."""
    ground, robot, pairs = touching(model)
    if len(pairs):
        return float(np.median(model.pair_friction[pairs, 0]))
    sides = [float(np.median(model.geom_friction[side, 0])) for side in (ground, robot) if len(side)]
    return max(sides, default=1.0)
