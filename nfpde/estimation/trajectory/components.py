"""Steps towards the likeliest sizes of the errors of states and of the simulation, and along the way there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.chains import Chains, Factor
from nfpde.estimation.trajectory.noise import Scatter

Array = NDArray[np.float64]

ROUNDING = 1e-13
"""Share of the largest eigenvalue, channels scaled to equal variance, below which one is a rounding error."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A scatter with what one pass over the windows finds with it.

    score: log likelihood [nats]
    weights: what every window tells of the next one                       (N,)
    innovations: of the residuals                                          (N, C)
    """

    scatter: Scatter
    score: float
    weights: Array
    factor: Factor
    innovations: Array


def rescaled(best: Judged, slopes: Array, inflation: float, *, full: bool) -> Scatter:
    """One step of the MM algorithm.

    Args:
        best: where from.
        slopes: derivative of every window's end by its start            (N, C, ndiff)
        inflation: of the squares, for the degrees of freedom that a fit has used up.
        full: whether the errors of the simulation have a full covariance, or a diagonal one.
    """
    scatter, chains = best.scatter, best.factor.chains
    u = best.factor.solution(best.innovations, best.weights)
    shown = inflation * np.einsum("ni,nj->ij", u, u)
    shown_sensor = inflation * squares_of_states(chains, u, slopes)
    expected_sensor, expected = visible(best.factor, best.weights, slopes)
    sensor = scatter.sensor * np.sqrt(shown_sensor / np.maximum(expected_sensor, 1e-300))
    process = _riccati(scatter.process, shown, expected) if full else _diagonal(scatter.process, shown, expected)
    return replace(scatter, sensor=sensor, process=process)


def extrapolated(old: Scatter, new: Scatter, stride: int, floors: tuple[Array, Array]) -> Scatter:
    """`stride` steps in the direction from `old` to `new` along the geodesic of covariances, a hundredfold at most."""
    low, high = 0.01 ** (1 / stride), 100.0 ** (1 / stride)
    ratio = np.clip(new.sensor / np.maximum(old.sensor, 1e-300), low, high) ** stride
    lower = np.linalg.cholesky(old.process)
    half = np.linalg.solve(lower, np.linalg.solve(lower, new.process).T)
    values, vectors = np.linalg.eigh(0.5 * (half + half.T))
    root = lower @ vectors * np.sqrt(np.clip(values, low, high) ** stride)
    sensor = np.maximum(old.sensor * ratio, floors[0] ** 2)
    return replace(new, sensor=sensor, process=at_least(root @ root.T, floors[1]))


def squares_of_states(chains: Chains, u: Array, slopes: Array) -> Array:
    """What residuals with solution u (N, C) show of the variances of states' errors, (ndiff,)."""
    # errors of states: those at which a window starts, linked to the one before or not, and those at which none starts
    ends, free = _ends(chains, u, slopes)
    return (at_starts(chains, u, slopes) ** 2).sum(0) + (ends[free] ** 2).sum(0)


def visible(factor: Factor, weights: Array, slopes: Array) -> tuple[Array, Array]:
    """What residuals show on average of the variances of the states' errors (ndiff,) and of the process (C, C)."""
    diagonal, below = factor.inverse_blocks(weights)
    ends, free = _ends(factor.chains, np.einsum("ncc->nc", diagonal), slopes)
    sensor = width_at_starts(factor.chains, diagonal, below, slopes).sum(0) + ends[free].sum(0)
    return sensor, diagonal.sum(0)


def _ends(chains: Chains, numbers: Array, slopes: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Numbers of channels (N, C) by step, (N, H, ndiff), and the steps at which no window starts (N, H)."""
    ends = numbers.reshape(len(numbers), -1, slopes.shape[2])
    free = np.ones(ends.shape[:2], bool)
    free[chains.followed, -1] = False
    return ends, free


def at_starts(chains: Chains, u: Array, slopes: Array) -> Array:
    """What residuals with solution u (N, C) show of the error of each window's start, (N, ndiff).

    Multiplied by the error's variance it is its mean.
    """
    ndiff = slopes.shape[2]
    first = np.einsum("ncd,nc->nd", slopes, u)
    after = np.flatnonzero(chains.linked)
    first[after] -= u[after - 1, -ndiff:]
    return first


def width_at_starts(chains: Chains, diagonal: Array, below: Array, slopes: Array) -> Array:
    """How much the residuals can show of the error of each window's start, (N, ndiff).

    Multiplied by the error's variance it is the share of the variance that the recording takes away.
    """
    ndiff = slopes.shape[2]
    wide = np.einsum("ncd,nce,ned->nd", slopes, diagonal, slopes, optimize=True)
    after = np.flatnonzero(chains.linked)
    wide[after] += np.einsum("ndd->nd", diagonal[after - 1, -ndiff:, -ndiff:])
    wide[after] -= 2 * np.einsum("ncd,ncd->nd", slopes[after], below[after][:, :, -ndiff:])
    return wide


def _riccati(process: Array, shown: Array, expected: Array) -> Array:
    """X with X expected X = process shown process, positive definite: the MM step of a full covariance."""
    size = np.sqrt(np.diag(process))
    q, target, weight = (process / np.outer(size, size), *(m * np.outer(size, size) for m in (shown, expected)))
    values, vectors = np.linalg.eigh(weight)
    # of residuals that are nearly dependent the least are rounding errors, and may be negative
    lengths = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    side = q @ vectors * lengths
    squares, turns = np.linalg.eigh(side.T @ target @ side)
    half = (vectors / lengths) @ turns * np.maximum(squares, 0.0) ** 0.25
    return half @ half.T * np.outer(size, size)


def _diagonal(process: Array, shown: Array, expected: Array) -> Array:
    return np.diag(np.diag(process) * np.sqrt(np.diag(shown) / np.maximum(np.diag(expected), 1e-300)))


def at_least(covariance: Array, floor: Array) -> Array:
    """The covariance with no direction below the floor's variance, or so far below the others' that it is rounding."""
    sound = definite(covariance)
    scaled = sound / np.outer(floor, floor)
    try:
        # Cholesky's factor keeps the digits of channels of very different size, which eigenvectors mix
        np.linalg.cholesky(scaled - np.eye(len(floor)))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(scaled)
        return definite((vectors * np.maximum(values, 1.0)) @ vectors.T * np.outer(floor, floor))
    return sound


def definite(covariance: Array) -> Array:
    """The covariance with no combination of channels below rounding errors, so that it has a Cholesky factor.

    The steps of one window of a clean recording are the same but for 1e-9, whose square double precision does not hold
    beside 1. Channels count in their own standard deviations: their sizes may be as different as they like.
    """
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    least = ROUNDING * values[-1]
    if values[0] >= least:
        return covariance
    return (vectors * np.maximum(values, least)) @ vectors.T * np.outer(size, size)
