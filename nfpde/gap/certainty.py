"""How well fitted values are known, where the likelihood is rough too.

Contacts that open or close a little earlier make jumps in what a model predicts. Slopes then hold over next to nothing,
and standard errors that follow from them are ten to a thousand times too small. Here the windows that no fit saw are
asked how their cost rises to either side of the fit, as far out as it takes to tell a rise from the jumps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.fit import PRIOR, Fit
from nfpde.gap.trial import Court

Array = NDArray[np.float64]

INTERVAL = 1.96
"""Half the width of a 95 % interval, in standard errors."""

NEAREST = 0.5
"""Distance from the fit, in the standard errors that slopes foretell, from which it is doubled."""

_ROUGH = 3.0
"""Roots of the likelihood for each nat of roughness. A jump to a plateau of height c misses a parabola by 3 c / 4; so
many of these are more than 2 c, and no plateau is taken for a rise."""

_FARTHER = 4
"""Doublings for which a rise must last at least; those beyond are not looked at once windows object."""

_OBJECTS = 4.0
"""Nats by which they must then, in the mean: pits are as deep as bumps are many."""


def standard_errors(court: Court, fit: Fit) -> Array:
    """Of a fit's free parameters, in their units (D,).

    Along the axes of the ellipsoid that slopes foretell, the cost of the held-out windows is taken at distances s that
    double, in its standard errors, at most to where the prior ends. A smooth cost rises by s^2 / 2 in the mean of both
    sides. By how much a rise misses a quarter of that at 2 s is the roughness R [nats], unless it is as much as
    foretold there and from there on, and only becomes steeper: the largest miss of that axis so far, or the root mean
    square at one distance of all axes of which no rise is sure there, whichever is larger. The least cost lies wherever
    the rise is of the order of R, so the likelihood counts as its (1 + 3 R)-th root, and the error of an axis is where
    that has fallen by half a nat for good: the wall of a pit rises as slopes foretell, and then no more. What lasts of
    a rise is what is left of it where it grows by less than the distance farther out, up to a nat a window, from where
    on all there is to lose may be lost. Nothing is known better than slopes foretell, nor worse than the prior.

    Args:
        court: Of the windows that it was fitted to, and of those held out.
        fit: Linearised there.
    """
    local = fit.standard_errors
    if not len(local):
        return local
    replay, u = fit.replay, fit.replay.inward(fit.xi[None])[0]
    information, vectors = np.linalg.eigh(fit.information)
    lengths = 1.0 / np.sqrt(np.maximum(information, PRIOR**-2))  # rounding can make it less than the prior's
    axes = lengths[:, None] * vectors.T
    here = court.held.costs(replay, u[None], fit.scatter)[0]

    def rise(s: float, open_ones: NDArray[np.bool_]) -> Array:
        found, some = np.full(len(axes), np.inf), axes[open_ones]
        places = np.clip(np.concatenate([u + s * some, u - s * some]), 0.0, 1.0)
        found[open_ones] = court.held.costs(replay, places, fit.scatter).reshape(2, -1).mean(0) - here
        return found

    widest = PRIOR / lengths
    doublings = 2 + max(0, int(np.log2(widest.max() / NEAREST)))
    scales = np.array([NEAREST * 2.0**k for k in range(doublings)])
    open_ones = np.ones(len(axes), dtype=bool)
    rises = np.array([rise(s, open_ones) for s in scales[:2]])
    stretch, since = _stretch(rises, scales, widest, len(fit.residuals))
    while len(rises) < len(scales):
        told = (since >= _FARTHER) & (rises[-1] >= _OBJECTS * len(fit.residuals))
        open_ones &= ~told & (scales[len(rises) - 1] < widest)
        if not open_ones.any():
            break
        rises = np.vstack([rises, rise(scales[len(rises)], open_ones)])
        stretch, since = _stretch(rises, scales, widest, len(fit.residuals))
    across = stretch[:, None] * axes
    wide = np.sqrt(((across @ replay.outward_slopes(fit.xi).T) ** 2).sum(0))
    return np.maximum(local, wide)


def _stretch(rises: Array, scales: Array, widest: Array, windows: int) -> tuple[Array, NDArray[np.intp]]:
    """By how much the axes are longer than slopes foretell (D,), and for how many distances their rise has lasted (D,).

    Args:
        rises: Of the cost, at the first of the distances (S, D); infinite where they were not looked at any more.
        scales: All distances.
        widest: Where each axis is as long as the prior's (D,).
        windows: How many there are.
    """
    count, every = len(rises) - 1, np.arange(rises.shape[1])
    seen = np.isfinite(rises)
    apart = np.subtract(rises[:-1], rises[1:] / 4, out=np.zeros((count, len(every))), where=seen[1:])
    # what rises faster and faster, and all the way at least as foretold, is no jump: cosines, and products at zero
    steep = np.logical_and.accumulate((rises >= 0.5 * scales[: count + 1, None] ** 2)[::-1])[::-1][:-1]
    misses = np.where((scales[:count, None] < widest) & ~(steep & (apart < 0)), np.abs(apart), 0.0)
    # the least that is left of each rise farther out: one that is taken back there was a jump, one that stops a pit
    distance = np.minimum(scales[: count + 1, None], widest)
    steepness = np.where(rises < windows, rises / distance, np.inf)
    left = np.minimum(distance * _least_from_there_on(steepness), _least_from_there_on(rises))
    lasting = left[:-1]
    alone = np.maximum.accumulate(misses)
    sure = 2 * lasting >= 1.0 + _ROUGH * alone
    # an axis whose rise is sure shows no more than how steep it is
    looked_at = np.cumsum(sure, axis=0) <= 1
    shared = np.sqrt((misses**2 * looked_at).sum(1) / np.maximum(looked_at.sum(1), 1))
    root = 1.0 + _ROUGH * np.maximum(alone, np.maximum.accumulate(shared)[:, None])
    told = seen[:-1] & (2 * lasting >= root)
    first, any_ = told.argmax(0), told.any(0)
    stretch = scales[first] * np.sqrt(root[first, every] / np.maximum(2 * rises[first, every], 1e-300))
    return np.where(any_, np.minimum(stretch, widest), widest), np.where(any_, count - first, 0)


def _least_from_there_on(values: Array) -> Array:
    """The least of what is at each distance and farther out (S, D)."""
    return np.minimum.accumulate(values[::-1])[::-1]
