"""How far a parameter goes before it matters: distances over which residuals change by as much as there is of them.

Bounds say what is possible. A drag may be anything up to syrup, and what the recordings ask for is a hundredth of a
thousandth of that: a search that starts with steps of the bounds' size never sees it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.gap.chart import Chart
from nfpde.gap.fit import Fitter
from nfpde.gap.levels import calm
from nfpde.gap.replay import Replay

Array = NDArray[np.float64]

_TURNS = 4
"""Times that a distance is corrected at most: what contacts do is not proportional to it."""

_NEAREST = 1e-3
"""Factor of one correction at least."""

_MOST, _AIM = 1.0, np.sqrt(0.2)
"""Change, in sizes of the residuals, beyond which the way there is not straight, and what is aimed at instead."""

_SAME = 0.3
"""Values as close as this share of their distance from neutral are one."""

_FIRST = 0.2
"""Distance that is tried first, in the chart's units."""


def change(there: Array, own: Array, floor: Array) -> Array:
    """Root mean squares (G,) of changes of residuals, `there` (G, N, nv, C) against `own` (N, nv, C), in sizes of own.

    Args:
        there: Residuals elsewhere.
        own: Residuals here, the measure of every channel; a share of the largest is capped.
        floor: Smallest residual believed (nv, C).
    """
    scale = np.sqrt(calm(own**2).mean(0) + floor**2)
    return np.array([np.sqrt(calm(((r - own) / scale) ** 2).mean()) for r in there])


def matched(
    fitter: Fitter, replay: Replay, effect: Effect, base: Array, values: Array, own: Array, floor: Array
) -> Array:
    """Values (K, P) of an effect brought toward neutral until they change residuals by no more than there is of them.

    Args:
        fitter: Of the windows.
        replay: What is simulated, the effect's parameters last.
        effect: The effect.
        base: All other parameters (D - P,).
        values: Values to start from (K, P).
        own: Residuals without the effect (N, nv, C).
        floor: Smallest residual believed (nv, C).

    Returns:
        Values, those that became the same as others left out; as they were where the bounds hold no neutral values.
    """
    decisive = np.array([not q.shape_only for q in effect.quantities])
    neutral = np.array([q.neutral for q in effect.quantities])
    if not reachable(effect):
        return values
    values, open_ones = values.copy(), np.arange(len(values))
    for _ in range(_TURNS):
        there = fitter.residuals_at(replay, np.hstack([np.tile(base, (len(open_ones), 1)), values[open_ones]]))
        size = change(there, own, floor)
        far = size > _MOST
        open_ones, size = open_ones[far], size[far]
        if not len(open_ones):
            break
        closer = neutral + _shorter(size)[:, None] * (values[open_ones] - neutral)
        values[open_ones] = np.where(decisive, closer, values[open_ones])
    away = np.where(decisive, values - neutral, values)
    kept: list[int] = []
    for i, row in enumerate(away):
        if all((np.abs(row - away[j]) > _SAME * np.abs(away[j])).any() for j in kept):
            kept.append(i)
    return values[kept]


def reachable(effect: Effect) -> bool:
    """Whether an effect's bounds contain its neutral values: a limit does nothing beyond all that is ever asked for."""
    decisive = [(q, p) for q, p in zip(effect.quantities, effect.parameters, strict=True) if not q.shape_only]
    return all(p.low <= q.neutral <= p.high for q, p in decisive)


def near_neutral(effect: Effect, values: Array) -> Array:
    """Distances from neutral (P,) over which an effect's parameters count linearly; NaN where that is not known."""
    neutral = np.array([q.neutral for q in effect.quantities])
    away = np.abs(values - neutral).max(0)
    decisive = np.array([not q.shape_only for q in effect.quantities])
    return np.where(decisive & (away > 0) & reachable(effect), away, np.nan)


def reaches(fitter: Fitter, replay: Replay, xi: Array, floor: Array) -> Array:
    """Distances (D,), in the chart's units, over which each free parameter (D,) changes residuals noticeably."""
    chart, found = Chart(replay), np.full(len(xi), _FIRST)
    if not len(xi):
        return found
    own, at = fitter.residuals_at(replay, xi[None])[0], chart.inward(xi)
    sign = np.where(at > 0.5 * (chart.low + chart.high), -1.0, 1.0)
    for _ in range(_TURNS):
        there = fitter.residuals_at(replay, chart.outward(at + np.diag(sign * found)))
        size = change(there, own, floor)
        far = size > _MOST
        if not far.any():
            break
        found[far] *= _shorter(size[far])
    return found


def _shorter(size: Array) -> Array:
    """Factors of distances that changed residuals by too much."""
    return np.maximum(_AIM / size, _NEAREST)
