"""Friction between the robot and the world."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, Self

import mujoco
import numpy as np

from nfpde.effects.contacts import Index, meetings, touching
from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.errors import BadEffect


@register
class GroundFriction(Effect):
    """The sliding coefficient of every contact between the robot and the world: `geom_friction`, set.

    A contact takes the larger coefficient of its two geoms, so both sides are set: the world's to the value, the
    robot's to no more. Where one geom has the higher `priority` it takes that geom's, which is set to the value.
    Explicit pairs have a coefficient of their own. Neutral is what the model has.
    """

    name = "ground_friction"
    kind = None
    whole = "contact"
    quantities = (Quantity("sliding", "-", 0.0, math.inf, neutral=1.0, log=True),)
    sentence = "The ground is more or less slippery than in the model."
    confounders = ("contact_softness",)
    default_bounds: ClassVar[Bounds] = {"sliding": (0.05, 3.0)}
    decisive: Index
    """Geoms that are set to the value."""
    capped: Index
    """Geoms that must not exceed it."""
    pairs: Index

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """From ice, or a fifth of the model's coefficient, to three times it, where anything can touch the world."""
        ground, robot, _ = touching(model)
        own = _own(model)
        return {"sliding": (min(0.05, 0.2 * own), max(3.0, 3 * own))} if len(ground) and len(robot) else None

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
        ground, robot, bound.pairs = touching(model)
        if not len(ground) or not len(robot):
            raise BadEffect(f"{self.name}: nothing in this model can touch the world")
        ground, robot, ahead = meetings(model)
        bound.decisive = np.union1d(ground[ahead <= 0], robot[ahead > 0])
        bound.capped = np.setdiff1d(robot[ahead == 0], bound.decisive)
        bound.quantities = (replace(self.quantities[0], neutral=_own(model)),)
        return bound

    def screened(self, scales: DataScales) -> Array:
        """More slippery and less."""
        own, p = self.quantities[0].neutral, self.parameters[0]
        return np.clip(own * np.array([[0.2], [0.5], [0.8], [1.25], [2.0]]), 1.001 * p.low, 0.999 * p.high)

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Set what decides of every contact with the world."""
        value = float(values[0])
        if value == self.quantities[0].neutral:
            return
        model.geom_friction[self.decisive, 0] = value
        model.geom_friction[self.capped, 0] = np.minimum(model.geom_friction[self.capped, 0], value)
        model.pair_friction[self.pairs, :2] = value


def _own(model: mujoco.MjModel) -> float:
    """The model's coefficient, as MuJoCo's contacts take it from their geoms or pairs; of several the median."""
    ground, robot, ahead = meetings(model)
    sliding = model.geom_friction[:, 0]
    of_robot = np.where(ahead < 0, 0.0, sliding[robot])
    of_ground = np.where(ahead > 0, 0.0, sliding[ground])
    of_pairs = model.pair_friction[touching(model)[2], 0]
    found = np.concatenate([np.maximum(of_ground, of_robot), of_pairs])
    return max(float(np.median(found)), mujoco.mjMINMU) if len(found) else 1.0
