"""Search where slopes mislead: a few rounds of samples that gather about the best of them.

Contacts open and close, and each change makes a small step in the cost: slopes over short distances say nothing of
the way to the best value, the spread of many values does. What is searched for is the least gap, every channel in
units of its own residuals: a likelihood whose scatter was learned far away need not fall on the way there.
"""

from __future__ import annotations

from collections.abc import Callable

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

_BOX = 0.25
"""The same of parameters, as a share of their bounds."""

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
    costs = [spread(r, scatter.floor) for r in fitter.residuals_at(replay, guesses)]
    best = guesses[int(np.argmin(costs))]
    away = _Away.of(effect, best[columns])
    low, high = replay.low[columns], replay.high[columns]

    def place(at: Array) -> Array:
        xi = np.tile(best, (len(at), 1))
        xi[:, columns] = np.clip(away.outward(at), low, high)
        return xi

    return _gather(fitter, replay, place, away.inward(best[columns]), width, SAMPLES, scatter, seed)


def search_all(fitter: Fitter, fit: Fit, seed: int = 0) -> Fit:
    """The same for all free parameters of a fit together, over their bounds."""
    replay = fit.replay
    low, span = replay.low, replay.high - replay.low

    def place(at: Array) -> Array:
        return low + span * np.clip(at, 0.0, 1.0)

    return _gather(fitter, replay, place, (fit.xi - low) / span, _BOX, 2 * SAMPLES, fit.scatter, seed)


def _gather(
    fitter: Fitter,
    replay: Replay,
    place: Callable[[Array], Array],
    middle: Array,
    width: float,
    samples: int,
    scatter: Scatter,
    seed: int,
) -> Fit:
    """Rounds of samples, from one place on; `place` makes free parameters (S, D) of coordinates (S, k)."""
    size, total = len(middle), ROUNDS * samples
    sobol = qmc.Sobol(size, seed=seed)  # pyright: ignore[reportCallIssue]  (its stubs know the newer name alone)
    draws = norm.ppf(sobol.random(1 << (total - 1).bit_length())[:total])
    at, widths = middle[None], np.full(size, width)
    cost = np.array([spread(fitter.residuals_at(replay, place(at))[0], scatter.floor)])
    for part in draws.reshape(ROUNDS, samples, size):
        new = middle + widths * part
        found = [spread(r, scatter.floor) for r in fitter.residuals_at(replay, place(new))]
        at, cost = np.concatenate([at, new]), np.concatenate([cost, found])
        elite = at[np.argsort(cost, kind="stable")[: max(ELITE, samples // 4)]]
        middle, widths = elite.mean(0), np.maximum(elite.std(0, ddof=1), _NARROW * widths)
    return fitter.start(replay, place(at[[int(np.argmin(cost))]]), scatter)


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
