"""What residuals scatter by: learned for every degree of freedom from what a fit leaves over."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.student import Student, learn_students

Array = NDArray[np.float64]

KAPPA = 0.03
"""Residuals below this share of what the base model leaves are not weighed: who explains the gap to 0.1 % of its
variance explains it, and which of two such effects fits closer is a matter of numerics, not of evidence."""

PRECISION = 1e-7
"""Share of the motion below which differences are those of rounding, of solvers and of compilers."""

MOST_SHARE = 0.9
"""Of a scatter that one window is taken to make up, at most: without the rest of it nothing is left to count in."""

LOST = 1e3
"""A diverged window counts as a residual of so many times the floor in every channel: bad, but not beyond bounds."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """Student t noise of every degree of freedom over its channels (positions and velocities at all horizons).

    noises: one for each degree of freedom
    floor: smallest residual believed (nv, C)
    """

    noises: tuple[Student, ...]
    floor: Array

    def whiten(self, residuals: Array) -> Array:
        """White residuals, (..., N, nv, C) to the same shape."""
        return self.turned(np.where(np.isfinite(residuals), residuals, LOST * self.floor))

    def turned(self, residuals: Array) -> Array:
        """What `whiten` makes of residuals that are all finite, or of their slopes."""
        return (residuals.swapaxes(-3, -2) @ self._whiteners).swapaxes(-3, -2)

    def weights(self, white: Array) -> Array:
        """What each window counts in least squares, by degree of freedom: (..., nv, C) to (..., nv)."""
        return (self._degrees + white.shape[-1]) / (self._degrees + (white**2).sum(-1))

    def curvature(self, white: Array) -> Array:
        """What each window adds to the second derivative of a cost, by degree of freedom: (N, nv, C) to (N, nv).

        In the mean over the directions of a residual; less than its weight, as tails pull less the farther out.
        """
        squares, channels = (white**2).sum(-1), white.shape[-1]
        return self.weights(white) * (1.0 - 2.0 / channels * squares / (self._degrees + squares))

    def pulls_without(self, white: Array) -> Array:
        """White residuals times weights, as the scatter of all other windows has them: (N, nv, C) to the same shape.

        A scatter is a mean of squares over the windows; without one of them it is smaller in the direction of that
        one's residual, or in each of its channels where it has no correlations (Sherman and Morrison, 1950).
        """
        pulls = white * self.weights(white)[..., None]
        shares = pulls * white / len(white)
        crossed = np.array([(np.count_nonzero(n.whitener, axis=0) > 1).any() for n in self.noises])
        shares = np.where(crossed[:, None], shares.sum(-1, keepdims=True), shares)
        return pulls / (1.0 - np.minimum(shares, MOST_SHARE))

    def log_density(self, residuals: Array) -> Array:
        """Log density of windows, summed over degrees of freedom: (..., N, nv, C) to (..., N) [nats]."""
        squares, degrees = (self.whiten(residuals) ** 2).sum(-1), self._degrees
        costs = (degrees + residuals.shape[-1]) * np.log1p(squares / degrees)
        return sum(n.log_constant for n in self.noises) - 0.5 * costs.sum(-1)

    @cached_property
    def _whiteners(self) -> Array:
        return np.array([n.whitener for n in self.noises])

    @cached_property
    def _degrees(self) -> Array:
        return np.array([n.degrees for n in self.noises])


def learn_scatter(residuals: Array, fitted: int, floor: Array) -> Scatter:
    """Maximum-likelihood scatter of residuals (N, nv, C) that `fitted` parameters were fitted to."""
    share = max(1, fitted // residuals.shape[1])
    return Scatter(tuple(learn_students(residuals, share, floor)), floor)


def floor_of(residuals: Array, moved: Array) -> Array:
    """Smallest believable residual of every channel.

    Args:
        residuals: Of the base model, (N, nv, C).
        moved: By how much the channels change over the horizons, as residuals, (N, nv, C): the precision of a
            simulation is counted in these.

    Returns:
        Standard deviations (nv, C), positive.
    """
    squares = residuals**2
    squares = np.minimum(squares, np.nanquantile(squares, 0.98, axis=0))  # one bad window shall not hide the rest
    typical = np.sqrt(np.nanmean(squares, axis=0))
    return np.maximum(KAPPA * typical, precision_of(moved))


def precision_of(moved: Array) -> Array:
    """What simulations of the same motion may differ by (nv, C), where channels change by (N, nv, C)."""
    spread = np.sqrt((moved**2).mean(0))
    return PRECISION * np.maximum(spread, 1e-6 * spread.max(initial=0.0) + 1e-12)
