"""Kernels around robots, on centres drawn together so that smoothing does not widen the population."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.modes import LocalPosterior

Array = NDArray[np.float64]

TINY = 1e-300
"""In place of zero under a fraction."""


@dataclass(frozen=True, eq=False)
class Kernels:
    """The equal mixture of the robots' posteriors, every Gaussian widened by `smoothing` and its centre moved.

    A plain kernel estimate has the robots' variance and the kernel's. Here every robot at z_i is drawn toward the
    mean m_i of the robots near it, to m_i + a_i (z_i - m_i) with a_i^2 = 1 - s / v_i, where v_i is the variance of the
    robots near it and s the kernel's: what smoothing adds there is taken from the centres. Where the kernel is wider
    than what is near (s > v_i) the centre is m_i itself. With everything near this is the smoothed bootstrap that keeps
    the variance (Silverman, Young, The bootstrap: to smooth or not to smooth?, Biometrika 74, 1987; Jones, On
    correcting for variance inflation in kernel density estimation, Computational Statistics & Data Analysis 11, 1991);
    with near robots only it is data sharpening, which leaves kinds of robot where they are (Choi, Hall, Data sharpening
    as a prelude to density estimation, Biometrika 86, 1999).

    Only the places of the robots are drawn together: posteriors keep their widths, so that the mixture has the variance
    of the posteriors without smoothing and never more than with it alone. Robots are near each other as much as their
    smoothed posteriors overlap, in the geometric mean over the parameters, and s and v_i are sums over the parameters,
    in units of the smoothed posterior's variances: a parameter that the recordings leave unknown has no part in either.
    All Gaussians of a robot move by as much as the first of its posterior.

    robots: what is known of each
    smoothing: covariance of the kernel                                    (D, D)
    places: of the first modes                                             (G, D)
    widths: variances of the first modes, smoothed                         (G, D)
    nearness: of every two robots, 1 of each to itself                     (G, G)
    """

    robots: Sequence[LocalPosterior | Gaussians]
    smoothing: Array
    places: Array
    widths: Array
    nearness: Array

    @classmethod
    def of(
        cls,
        robots: Sequence[LocalPosterior | Gaussians],
        smoothing: Array,
        shapes: Sequence[LocalPosterior | Gaussians] | None = None,
    ) -> Kernels:
        """Around one robot or more; its cost grows with their number squared.

        Args:
            robots: posteriors, whose first Gaussians say where the robots are and what is known of them.
            smoothing: covariance of the kernel, (D, D).
            shapes: the same posteriors in more detail, of which the population is made; None for `robots` themselves.
        """
        places = np.array([r.means[0] for r in robots])
        widths = np.diag(smoothing) + np.array([np.diag(r.covariances[0]) for r in robots])
        squares = np.zeros((len(robots),) * 2)
        for place, width in zip(places.T, widths.T, strict=True):
            squares += (place[:, None] - place) ** 2 / (width[:, None] + width)
        return cls(shapes or robots, smoothing, places, widths, np.exp(-0.5 * squares / places.shape[1]))

    def mixture(self, without: int | None = None) -> Gaussians:
        """The population; without one robot it is that of all others, as if it had never been there."""
        owner, weights, means, covariances = self._parts
        moves = self.moves(without)
        if without is not None:
            stays = owner != without
            weights, means, covariances = (a[stays] for a in (weights, means, covariances))
            owner = owner[stays] - (owner[stays] > without)
        return Gaussians(weights / len(moves), means + moves[owner], covariances)

    def moves(self, without: int | None = None) -> Array:
        """From every robot's place to its centre, (G, D); of the others, (G - 1, D), without one robot."""
        z, shares = self._around_mean, 1 / self.widths
        if without is None:
            return _moves(z, self._sums, np.diag(self.smoothing), shares)
        gone, at = self.nearness[:, without, None], z[without]
        less = (gone, gone**2, gone * at, gone * at**2)
        left = [np.delete(a - b, without, axis=0) for a, b in zip(self._sums, less, strict=True)]
        z, shares = np.delete(z, without, axis=0), np.delete(shares, without, axis=0)
        return _moves(z, left, np.diag(self.smoothing), shares)

    @cached_property
    def _parts(self) -> tuple[NDArray[np.intp], Array, Array, Array]:
        """Of all Gaussians of all robots: whose it is, weight, mean, smoothed covariance."""
        owner = np.repeat(np.arange(len(self.robots)), [len(r.weights) for r in self.robots])
        weights, means, covariances = (
            np.concatenate([getattr(r, name) for r in self.robots]) for name in ("weights", "means", "covariances")
        )
        return owner, weights, means, covariances + self.smoothing

    @cached_property
    def _around_mean(self) -> Array:
        """The places from their mean, so that differences of squares keep their digits, (G, D)."""
        return self.places - self.places.mean(0)

    @cached_property
    def _sums(self) -> list[Array]:
        """Over all robots, near each: of nearness and its square (G, 1), of places and their squares (G, D)."""
        k, z = self.nearness, self._around_mean
        return [k.sum(1, keepdims=True), (k**2).sum(1, keepdims=True), k @ z, k @ z**2]


def _moves(z: Array, sums: list[Array], kernel: Array, shares: Array) -> Array:
    near, near_squared, first, second = sums
    mean = first / near
    # as many robots as take part, one of which the mean has used up
    count = near**2 / near_squared
    variance = (second / near - mean**2) * count / np.maximum(count - 1, TINY)
    added, there = (kernel * shares).sum(1, keepdims=True), (variance * shares).sum(1, keepdims=True)
    kept = np.sqrt(np.maximum(0.0, 1 - added / np.maximum(there, TINY)))
    return (1 - kept) * (mean - z)
