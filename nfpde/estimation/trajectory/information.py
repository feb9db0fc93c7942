"""Information matrices whose flat directions are flat, whatever rounding errors the sharp ones left there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

Array = NDArray[np.float64]

ROUNDING = 1e-12
"""Share of the largest eigenvalue, parameters scaled to equal information, below which one is a rounding error."""

TAKES_PART = 1e-6
"""Share of a parameter in a flat direction below which the direction is not its own."""

SHARPEST = 1e4
"""Root of the information about z that parameters may have whose combination is flat. 1e-16 of its square is far below
the information that the bounds are, even close to one of them, and they are all that is known of the combination."""


def without_rounding(information: Array, share: float = ROUNDING) -> Array:
    """An information matrix (D, D) in which what the recordings do not tell has no information.

    Clean recordings tell the sum of two masses to 1e-10 and nothing of their difference. The numbers of such a matrix
    are 1e20, and 1e-16 of them, which is chance, would outweigh any prior on the difference. Therefore eigenvalues at
    the size of rounding errors become zero (the parameters are scaled to equal information first, or those that are
    told less would be taken for flat), and parameters that have a flat direction in common, and no other, lose the
    sharpness that double precision cannot hold beside it. A matrix without flat directions comes back as it is.

    Args:
        information: the matrix.
        share: of the largest eigenvalue, below which one is an error.
    """
    *_, flat = _scaled(information, share)
    return softened_alike(information[None], share)[0] if flat.any() else information


def softened_alike(informations: Array, share: float = ROUNDING) -> Array:
    """The same `without_rounding` of places along one ridge (n, D, D), where all lose as much sharpness.

    How much the posterior has of each place goes by how sharp its information is beside the others'.
    """
    parts = [_scaled(information, share) for information in informations]
    softening = np.ones(informations.shape[1])
    for size, _, vectors, flat in parts:
        if flat.any():
            softening = np.minimum(softening, _softening(vectors[:, flat], size))
    found = informations * np.outer(softening, softening)
    for i, (size, values, vectors, flat) in enumerate(parts):
        if flat.any():
            own = (vectors * np.where(flat, 0.0, values)) @ vectors.T * np.outer(size * softening, size * softening)
            found[i] = 0.5 * (own + own.T)
    return found


def standard_errors(information: Array) -> Array:
    """Roots of the diagonal of the inverse of a matrix (D, D), (D,); infinite where a flat direction takes part."""
    size, values, vectors, flat = _scaled(information)
    variances = np.where(flat, 0.0, 1.0 / np.where(flat, 1.0, values))
    variance = (vectors**2 * variances).sum(1)
    return np.where(((vectors**2)[:, flat] > TAKES_PART).any(1), np.inf, np.sqrt(variance) / size)


def inverse(matrices: Array) -> Array:
    """Inverses of positive definite matrices (..., D, D), positive definite as well.

    By way of Cholesky's factors, whose condition is the root of the matrices': a general inverse of a matrix that tells
    one direction 1e4 times better than another has errors of 1e-8 of its largest value, a negative one at times.
    """
    factors = np.linalg.inv(np.linalg.cholesky(matrices))
    return factors.swapaxes(-1, -2) @ factors


def _scaled(information: Array, share: float = ROUNDING) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Sizes of the parameters; eigenvalues, eigenvectors, and which are flat, when all have the size 1.

    Information about z below 1 is less than most of the box has by itself, and no size to be scaled up from.
    """
    size = np.sqrt(np.maximum(np.diag(information), 1.0))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    return size, values, vectors, values <= share * max(float(values[-1]), 1e-300)


def _softening(flat: Array, size: Array) -> Array:
    """Factor on the size of every parameter (D,), the same for all that flat directions (D, F) tie together."""
    together = flat @ flat.T
    groups, group = connected_components(np.abs(together) > TAKES_PART, directed=False)
    factor = np.ones(len(size))
    for g in range(groups):
        own = np.flatnonzero(group == g)
        shares, directions = np.linalg.eigh(together[np.ix_(own, own)])
        directions = directions[:, shares > 0.5]
        if directions.shape[1]:
            shortest = np.linalg.svd(directions / size[own, None], compute_uv=False)[-1]
            factor[own] = min(1.0, SHARPEST * float(shortest))
    return factor
