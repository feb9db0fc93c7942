"""Coordinates in which equal steps are about equally large changes, for searches over wide ranges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from nfpde.gap.replay import Replay

Array = NDArray[np.float64]

_NEARBY = 0.01
"""Share of an effect's bounds below which its size counts linearly, above which by its logarithm."""

_BOUNDS = 4.0
"""Width of the bounds of a parameter that is no effect's, in units of its coordinate."""


class Chart:
    """Coordinates of a replay's free parameters: one unit is a change by a factor e, or a quarter of the bounds.

    An effect may be of any size and, where both sides of neutral are allowed, of either sign: its coordinate is the
    logarithm of a ratio or a time scale, and else the signed logarithm of the distance from neutral, linear near it.

    Args:
        replay: Whose free parameters.

    Attributes:
        low, high: coordinates of the bounds (D,).
    """

    def __init__(self, replay: Replay) -> None:
        self._low, self._high = replay.low, replay.high
        self._log = np.zeros(replay.nfree, dtype=bool)
        self._unit = np.zeros(replay.nfree)
        self._zero = replay.low.copy()
        for index, effect in enumerate(replay.effects):
            columns = range(*replay.columns(index).indices(replay.nfree))
            for column, quantity in zip(columns, effect.quantities, strict=True):
                low, high = float(replay.low[column]), float(replay.high[column])
                finite = np.isfinite(quantity.neutral)
                if low > 0 and (quantity.log or not finite):
                    self._log[column] = True
                else:
                    zero = float(np.clip(quantity.neutral, low, high)) if finite else low
                    self._zero[column] = zero
                    self._unit[column] = _NEARBY * max(high - zero, zero - low)
        self.low, self.high = self.inward(self._low), self.inward(self._high)

    def inward(self, xi: Array) -> Array:
        """Coordinates of free parameters (..., D)."""
        away = xi - self._zero
        signed = np.sign(away) * np.log1p(np.abs(away) / np.where(self._unit > 0, self._unit, 1.0))
        share = _BOUNDS * away / (self._high - self._low)
        ratio = np.log(np.where(self._log, np.maximum(xi, 1e-300), 1.0))
        return np.where(self._log, ratio, np.where(self._unit > 0, signed, share))

    def outward(self, at: Array) -> Array:
        """Free parameters of coordinates (..., D), brought inside the bounds."""
        at = np.clip(at, self.low, self.high)
        signed = np.sign(at) * self._unit * np.expm1(np.where(self._unit > 0, np.abs(at), 0.0))
        share = at * (self._high - self._low) / _BOUNDS
        ratio = np.exp(np.where(self._log, at, 0.0))
        inside = np.where(self._log, ratio, self._zero + np.where(self._unit > 0, signed, share))
        return np.clip(inside, self._low, self._high)


def all_over(replay: Replay, index: int, xi: Array, count: int, share: float = 1.0) -> Array:
    """Guesses (count, D) with values of an effect all over its bounds, or over a share of them about its own.

    Args:
        replay: The effect is one of its.
        index: Which.
        xi: Free parameters (D,); those of the effect are the middle of a share.
        count: How many.
        share: Of the bounds' width, in the chart's coordinates.
    """
    chart, columns = Chart(replay), np.arange(replay.nfree)[replay.columns(index)]
    others = np.setdiff1d(np.arange(replay.nfree), columns)
    low, high = chart.low[columns], chart.high[columns]
    middle = chart.inward(xi)[columns] if share < 1 else 0.5 * (low + high)
    at = np.zeros((count, replay.nfree))
    at[:, columns] = np.clip(middle + share * (high - low) * (_even(count, len(columns)) - 0.5), low, high)
    found = chart.outward(at)
    found[:, others] = xi[others]
    return found


def evenly(replay: Replay, count: int) -> Array:
    """Guesses (count, D) of free parameters all over their bounds, in the chart's coordinates."""
    chart = Chart(replay)
    return chart.outward(chart.low + (chart.high - chart.low) * _even(count, replay.nfree))


def _even(count: int, size: int) -> Array:
    """Points spread evenly over the unit cube (count, size), shifted at random."""
    if size == 1:
        points = np.arange(count)[:, None] / count
    else:
        points = qmc.Sobol(size, scramble=False).random(1 << (count - 1).bit_length())[:count]
    return (points + np.random.default_rng(0).random(size)) % 1.0
