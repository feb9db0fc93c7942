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

NEAREST = 0.5
"""Distance from the fit, in the standard errors that slopes foretell, from which it is doubled."""

_ROUGH = 3.0
"""Roots of the likelihood for each nat of roughness. A jump to a plateau of height c misses a parabola by 3 c / 4; so
many of these are more than 2 c, and no plateau is taken for a rise."""


def standard_errors(court: Court, fit: Fit) -> Array:
    """Of a fit's free parameters, in their units (D,).

    Along the axes of the ellipsoid that slopes foretell, the cost of the held-out windows is taken at distances s that
    double, in its standard errors, until they are the prior's. A smooth cost rises by s^2 / 2 in the mean of both
    sides. By how much a rise misses a quarter of that at 2 s is the roughness R [nats]: the largest miss of that axis
    so far, or the root mean square at one distance of all axes of which no rise is sure there, whichever is larger. The
    least cost lies wherever the
    rise is of the order of R, so the likelihood counts as its (1 + 3 R)-th root, and the error of an axis is where
    that has fallen by half a nat for good. Nothing is known better than slopes foretell, nor worse than the prior.

    Args:
        court: Of the windows that it was fitted to, and of those held out.
        fit: Linearised there.
    """
    local = fit.standard_errors
    if not len(local):
        return local
    replay, u = fit.replay, fit.replay.inward(fit.xi[None])[0]
    variances, vectors = np.linalg.eigh(np.linalg.pinv(fit.information, hermitian=True))
    axes = (vectors * np.sqrt(np.maximum(variances, 0.0))).T
    lengths = np.linalg.norm(axes, axis=1)
    here = court.held.costs(replay, u[None], fit.scatter)[0]

    def rise(s: float) -> Array:
        places = np.clip(np.concatenate([u + s * axes, u - s * axes]), 0.0, 1.0)
        return court.held.costs(replay, places, fit.scatter).reshape(2, -1).mean(0) - here

    widest = PRIOR / np.maximum(lengths, 1e-300)
    scales = NEAREST * 2.0 ** np.arange(2 + max(0, int(np.log2(widest.max() / NEAREST))))
    rises = np.array([rise(s) for s in scales])
    misses = np.where(scales[:-1, None] < widest, np.abs(rises[:-1] - rises[1:] / 4), 0.0)
    # the least rise from each distance on: one that is taken back farther out was a jump
    lasting = np.minimum.accumulate(rises[::-1])[::-1][:-1]
    alone = np.maximum.accumulate(misses)
    told = 2 * lasting >= 1.0 + _ROUGH * alone
    # of an axis that is told already, only how steep it is shows farther out
    open_ = np.cumsum(told, axis=0) <= 1
    shared = np.sqrt((misses**2 * open_).sum(1) / np.maximum(open_.sum(1), 1))
    root = 1.0 + _ROUGH * np.maximum(alone, np.maximum.accumulate(shared)[:, None])
    told = 2 * lasting >= root
    first, every = told.argmax(0), np.arange(len(axes))
    stretch = scales[first] * np.sqrt(root[first, every] / np.maximum(2 * rises[first, every], 1e-300))
    stretch = np.where(told.any(0), np.minimum(stretch, widest), widest)
    across = stretch[:, None] * axes
    wide = np.sqrt(((across @ replay.outward_slopes(fit.xi).T) ** 2).sum(0))
    return np.maximum(local, wide)
