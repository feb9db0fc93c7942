"""How much fitted parameters scatter: by how much they move when a window is left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.noise import Scatter

Array = NDArray[np.float64]

_DIGITS = 1e-13
"""Share of a matrix, its diagonal scaled to one, that double precision cannot tell from nothing."""


def moves_without(scatter: Scatter, residuals: Array, slopes: Array, prior: Array) -> Array:
    """By how much each window in turn moves the parameters when it is left out (N, D).

    One Newton step from the fit to the windows that are left, which no longer shape the scatter either: a hundred
    windows of ten channels whiten themselves so well that by their own scatter they would seem to say a fifth more than
    they do. The sum of the squares is the jackknife's variance (Efron and Stein, Annals of Statistics 1981), whatever
    the windows scatter by, as long as they are independent.

    Args:
        scatter: Of the residuals.
        residuals: Of the fit (N, nv, C).
        slopes: Of the white residuals by each parameter (D, N, nv, C).
        prior: Information beside the windows' (D, D).
    """
    white = scatter.whiten(residuals)
    each = np.einsum("dnvc,nv,envc->nde", slopes, scatter.curvature(white), slopes, optimize=True)
    pulls = np.einsum("dnvc,nvc->nd", slopes, scatter.pulls_without(white))
    # summed, not subtracted: a window that alone tells a parameter would leave rounding errors
    rest = prior + _sums_before(each) + _sums_before(each[::-1])[::-1]
    size = 1.0 / np.sqrt(np.einsum("ndd->nd", rest))
    inverse = np.linalg.pinv(rest * size[:, :, None] * size[:, None], rcond=_DIGITS, hermitian=True)
    return np.einsum("nde,ne->nd", inverse, pulls * size) * size


def _sums_before(parts: Array) -> Array:
    """Of all entries before each one (N, ...)."""
    return np.concatenate([np.zeros_like(parts[:1]), np.cumsum(parts, axis=0)[:-1]])
