"""In which directions noise is loud in each window: whitening by the whole covariance that the sensors' noise gives it.

Where a foot presses, a height that is measured wrong moves all joints at once, far more than their own noise does, and
always in the same proportion. Counted one by one every joint is loud; across that direction all of them are quiet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.loud import Loudness, aside
from nfpde.gap.noise import learn_scatter
from nfpde.gap.replay import Replay, displaced

Array = NDArray[np.float64]

POWERS = (0.25, 0.5, 0.75, 1.0)
"""Powers of the covariances tried: noise that is known badly is trusted in part."""


LOOSE = 10.0
"""Times as large as it is that the error of a velocity at a start counts, where that is no noise of a sensor: a
hundredth of its square is left, as little as `FLOOR_ERROR` leaves alone."""


@dataclass(frozen=True, eq=False)
class Directions:
    """Whitens the residuals of each window; the size of every channel stays what it is on average.

    turn: matrices (N, nv C, nv C)
    """

    turn: Array

    def quieten(self, residuals: Array) -> Array:
        """Residuals (..., N, nv, C) with their loud directions shrunk."""
        flat = residuals.reshape(*residuals.shape[:-2], -1)
        return np.einsum("nij,...nj->...ni", self.turn, flat, optimize=True).reshape(residuals.shape)

    def some(self, index: NDArray[np.intp] | slice) -> Directions:
        """The same of some windows."""
        return Directions(self.turn[index])

    @property
    def log_volume(self) -> float:
        """Logarithm of what densities change by, summed over windows [nats]."""
        return float(np.linalg.slogdet(self.turn)[1].sum())


def noise_covariance(
    replay: Replay,
    xi: Array,
    windows: Windows,
    horizons: Sequence[int],
    sigma: Array,
    seen: Callable[[Array], Array] = lambda residuals: residuals,
    loose: NDArray[np.bool_] | None = None,
    force: Array | None = None,
) -> Array:
    """Covariance of the residuals of every window by noise of the sensors (2 nv,) at its start and ends, (N, m, m).

    Each noise is followed by one standard deviation to either side (divided differences: Norgaard, Poulsen, Ravn,
    Automatica 2000).

    Args:
        replay: The model.
        xi: Its free parameters (D,).
        windows: Of recordings (N).
        horizons: Control steps after which they are compared.
        sigma: Noise of the sensors.
        seen: Takes those residuals that are looked at out of all (..., nv, C).
        loose: Which channels nobody measured (2 nv,): how they err at a start goes with the motion, and what goes in
            proportion to that counts `LOOSE` times.
        force: Typical generalized forces (nv,), by a share of which the model is pushed aside; None: it is not.

    Returns:
        Over m = nv C channels, those of a degree of freedom next to each other.
    """
    change = seen(replay.by_dof(displaced(replay, xi, windows, horizons, sigma, aside(force, replay.nv))))
    columns = change.reshape(-1, len(windows), change.shape[-2] * change.shape[-1])
    ends = seen(replay.by_dof(np.tile(sigma**2, (len(horizons), 1)))).ravel()
    covariance = 0.5 * np.einsum("kni,knj->nij", columns, columns, optimize=True) + np.diag(ends)
    if loose is not None:
        up, down = columns.reshape(2, len(sigma), *columns.shape[1:])[:, np.flatnonzero(loose)]
        slope = np.sqrt(LOOSE**2 - 1.0) * 0.5 * (up - down)
        covariance += np.einsum("kni,knj->nij", slope, slope, optimize=True)
    return covariance


def likeliest_directions(covariance: Array, residuals: Array, floor: Array, plain: Loudness) -> Directions | Loudness:
    """What makes the residuals of a model likeliest: a power of the covariances, or loudness channel by channel.

    Args:
        covariance: By noise, of every window (N, m, m).
        residuals: Of the base model (N, nv, C).
        floor: Smallest residual believed (nv, C); noise below it counts as that.
        plain: Loudness channel by channel.
    """
    whole = covariance + np.diag(floor.ravel() ** 2)
    size = np.sqrt(np.einsum("nii->i", whole) / len(whole))
    values, vectors = np.linalg.eigh(whole / np.outer(size, size))
    values = np.maximum(values, 1e-12)  # the floor keeps them positive, but for rounding

    def power(alpha: float) -> Directions:
        root = np.einsum("nij,nj,nkj->nik", vectors, values ** (-0.5 * alpha), vectors, optimize=True)
        return Directions(root * size[:, None] / size)

    def likelihood(one: Directions | Loudness) -> float:
        quiet = one.quieten(residuals)
        return one.log_volume + float(learn_scatter(quiet, 0, floor).log_density(quiet).sum())

    best, most = plain, likelihood(plain)
    for alpha in POWERS:  # one at a time: over many windows each of them is large
        tried = power(alpha)
        if (likely := likelihood(tried)) > most:
            best, most = tried, likely
    return best
