"""Search where slopes mislead: a few rounds of samples that gather about the best of them.

Contacts open and close, and each change makes a small step in the cost: slopes over short distances say nothing of
the way to the best value, the spread of many values does. What is searched for is the least gap, every channel in
units of its own residuals: a likelihood whose scatter was learned far away need not fall on the way there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from nfpde.effects import Effect
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.levels import calm
from nfpde.gap.noise import Scatter
from nfpde.gap.replay import Replay

Array = NDArray[np.float64]

ROUNDS, SAMPLES, ELITE = 5, 16, 4
"""Rounds, samples in each, and those of them that the next round gathers about."""

WIDE, NEAR = 1.0, 0.15
"""First standard deviation of the samples' logarithms: of effects of unknown size, and of those that were fitted."""

_NARROW = 0.3
"""Least share of a standard deviation that is left after each round."""


def spread(residuals: Array, floor: Array) -> float:
    """Negative log likelihood [nats] of residuals (N, nv, C) whose channels scatter each by as much as they do."""
    variance = calm(residuals**2).mean(0) + floor**2
    return 0.5 * len(residuals) * float(np.log(variance).sum())


def search(
    fitter: Fitter, replay: Replay, index: int, guesses: Array, scatter: Scatter, width: float = WIDE, seed: int = 0
) -> Fit:
    """The best of what cross-entropy search finds for an effect's values; other parameters as in a guess.

    Args:
        fitter: Of the windows.
        replay: What is simulated.
        index: Which of its effects.
        guesses: Free parameters to start from (G, D); the best of them is searched about.
        scatter: What the cost of the fit is counted with.
        width: First standard deviation of the samples' logarithms.
        seed: Of the samples.
    """
    columns, effect = replay.columns(index), replay.effects[index]
    size = len(effect.parameters)
    floor = scatter.floor
    costs = [spread(r, floor) for r in fitter.residuals_at(replay, guesses)]
    first = int(np.argmin(costs))
    best, best_cost = guesses[first], costs[first]
    away = _Away.of(effect, best[columns])
    middle, widths = away.inward(best[columns]), np.full(size, width)
    at, cost = middle[None], np.array([best_cost])
    total = ROUNDS * SAMPLES
    draws = norm.ppf(qmc.Sobol(size, seed=seed).random(1 << (total - 1).bit_length())[:total])
    low, high = replay.low[columns], replay.high[columns]
    for part in draws.reshape(ROUNDS, SAMPLES, size):
        xi = np.tile(best, (SAMPLES, 1))
        xi[:, columns] = np.clip(away.outward(middle + widths * part), low, high)
        found = np.array([spread(r, floor) for r in fitter.residuals_at(replay, xi)])
        if found.min() < best_cost:
            best, best_cost = xi[int(found.argmin())], float(found.min())
        at, cost = np.concatenate([at, away.inward(xi[:, columns])]), np.concatenate([cost, found])
        elite = at[np.argsort(cost, kind="stable")[:ELITE]]
        middle, widths = elite.mean(0), np.maximum(elite.std(0, ddof=1), _NARROW * widths)
    return fitter.start(replay, best[None], scatter)


class _Away:
    """Values as logarithms: of themselves where they span decades, else of their distance from neutral."""

    def __init__(self, zero: Array, sign: Array) -> None:
        self.zero, self.sign = zero, sign

    @classmethod
    def of(cls, effect: Effect, values: Array) -> _Away:
        """On the side of neutral where the values are."""
        plain = [0.0 if q.log or not np.isfinite(q.neutral) else q.neutral for q in effect.quantities]
        return cls(np.array(plain), np.where(values >= plain, 1.0, -1.0))

    def inward(self, values: Array) -> Array:
        return np.log(np.maximum(np.abs(values - self.zero), 1e-12))

    def outward(self, logs: Array) -> Array:
        return self.zero + self.sign * np.exp(logs)
