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

_WIDTH, _NARROW = 1.0, 0.3
"""First standard deviation of the samples' logarithms, and the least share of it that is left after each round."""


def spread(residuals: Array, floor: Array) -> float:
    """Negative log likelihood [nats] of residuals (N, nv, C) whose channels scatter each by as much as they do."""
    variance = calm(residuals**2).mean(0) + floor**2
    return 0.5 * len(residuals) * float(np.log(variance).sum())


def search(fitter: Fitter, replay: Replay, effect: Effect, guesses: Array, scatter: Scatter, seed: int = 0) -> Fit:
    """The best of what cross-entropy search finds for the last effect's values; other parameters as in a guess.

    Args:
        fitter: Of the windows.
        replay: With the effect as its last.
        effect: It.
        guesses: Free parameters to start from (G, D); the best of them is searched about.
        scatter: What the cost of the fit is counted with.
        seed: Of the samples.
    """
    size = len(effect.parameters)
    floor = scatter.floor
    residuals = fitter.residuals_at(replay, guesses)
    costs = [spread(r, floor) for r in residuals]
    first = int(np.argmin(costs))
    best, best_cost = guesses[first], costs[first]
    away = _Away.of(effect, best[-size:])
    middle, width = away.inward(best[-size:]), np.full(size, _WIDTH)
    at, cost = middle[None], np.array([best_cost])
    total = ROUNDS * SAMPLES
    draws = norm.ppf(qmc.Sobol(size, seed=seed).random(1 << (total - 1).bit_length())[:total])
    low, high = replay.low[-size:], replay.high[-size:]
    for part in draws.reshape(ROUNDS, SAMPLES, size):
        values = np.clip(away.outward(middle + width * part), low, high)
        xi = np.hstack([np.broadcast_to(best[:-size], (SAMPLES, len(best) - size)), values])
        found = np.array([spread(r, floor) for r in fitter.residuals_at(replay, xi)])
        if found.min() < best_cost:
            best, best_cost = xi[int(found.argmin())], float(found.min())
        at, cost = np.concatenate([at, away.inward(values)]), np.concatenate([cost, found])
        elite = at[np.argsort(cost, kind="stable")[:ELITE]]
        middle, width = elite.mean(0), np.maximum(elite.std(0, ddof=1), _NARROW * width)
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
