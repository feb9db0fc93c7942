"""Give of the ground."""

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
class ContactSoftness(Effect):
    """Time constant and damping ratio of every contact between the robot and the world: `geom_solref`, set.

    Neutral is what the model has. MuJoCo keeps time constants above two physics steps.
    """

    name = "contact_softness"
    kind = None
    whole = "contact"
    quantities = (
        Quantity("time_constant", "s", 1e-5, math.inf, neutral=0.02, log=True),
        Quantity("damping_ratio", "-", 1e-3, math.inf, neutral=1.0, log=True),
    )
    default_bounds: ClassVar[Bounds] = {"time_constant": (0.004, 0.3), "damping_ratio": (0.05, 4.0)}
    sentence = "The ground or the foot is softer, or bounces more, than in the model."
    confounders = ("ground_height", "ground_friction")
    ground: Index
    robot: Index
    pairs: Index

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """From two physics steps to fifteen times the model's time constant, where anything can touch the world."""
        ground, robot, _ = touching(model)
        time_constant, ratio = _own(model)
        if not len(ground) or not len(robot) or time_constant <= 0 or ratio <= 0:
            return None
        least = 2.01 * float(model.opt.timestep)
        return {
            "time_constant": (min(least, 0.9 * time_constant), max(15 * time_constant, 10 * least)),
            "damping_ratio": (0.05 * ratio, 4.0 * ratio),
        }

    @classmethod
    def candidates(cls, model: mujoco.MjModel, scales: DataScales) -> list[Effect]:
        """The effect, bound: its neutral values are the model's own."""
        return [e.bind(model) for e in super().candidates(model, scales)]

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: nothing can touch the world, or the model gives stiffness and damping (negative `solref`).
        """
        bound = super().bind(model)
        bound.ground, bound.robot, bound.pairs = touching(model)
        if not len(bound.ground) or not len(bound.robot):
            raise BadEffect(f"{self.name}: nothing in this model can touch the world")
        own = _own(model)
        if min(own) <= 0:
            raise BadEffect(f"{self.name}: the model gives its contacts' solref as stiffness and damping {own}")
        bound.quantities = tuple(replace(q, neutral=v) for q, v in zip(self.quantities, own, strict=True))
        return bound

    def screened(self, scales: DataScales) -> Array:
        """Softer and harder, bouncing and damped."""
        own = np.array([q.neutral for q in self.quantities])
        factors = np.array([[0.5, 1.0], [1.5, 1.0], [3.0, 1.0], [8.0, 1.0], [1.0, 0.3], [1.0, 2.0]])
        low, high = (np.array([getattr(p, side) for p in self.parameters]) for side in ("low", "high"))
        return np.clip(own * factors, 1.001 * low, 0.999 * high)

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Set both sides of every contact with the world."""
        if all(v == q.neutral for v, q in zip(values, self.quantities, strict=True)):
            return
        both = np.concatenate([self.ground, self.robot])
        model.geom_solref[both] = values
        model.pair_solref[self.pairs] = values


def _own(model: mujoco.MjModel) -> tuple[float, float]:
    """The model's time constant and damping ratio, as MuJoCo's contacts take them from their geoms or pairs.

    Of several the median. A contact takes those of the geom with the higher priority; at equal priority it mixes them
    by `geom_solmix`, or takes the smaller where one of them is a stiffness and a damping.
    """
    ground, robot, ahead = meetings(model)
    of_ground, of_robot = model.geom_solref[ground], model.geom_solref[robot]
    weights = np.maximum(model.geom_solmix, mujoco.mjMINVAL)  # as MuJoCo: two weights of zero count as equal
    share = (weights[ground] / (weights[ground] + weights[robot]))[:, None]
    times = ((of_ground[:, 0] > 0) & (of_robot[:, 0] > 0))[:, None]
    mixed = np.where(times, share * of_ground + (1 - share) * of_robot, np.minimum(of_ground, of_robot))
    first = ahead[:, None]
    mixed = np.where(first > 0, of_robot, np.where(first < 0, of_ground, mixed))
    found = np.concatenate([mixed, model.pair_solref[touching(model)[2]]])
    time_constant, ratio = np.median(found, axis=0) if len(found) else (0.02, 1.0)
    return float(time_constant), float(ratio)
