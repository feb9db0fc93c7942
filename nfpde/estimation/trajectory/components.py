"""Steps towards the likeliest sizes of the errors of states and of the simulation, and along the way there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.chains import Chains, Factor
from nfpde.estimation.trajectory.freedom import MOST_USED, Used
from nfpde.estimation.trajectory.noise import Scatter

Array = NDArray[np.float64]

ROUNDING = 1e-13
"""Share of the largest eigenvalue, channels scaled to equal variance, below which one is a rounding error."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A scatter with what one pass over the windows finds with it.

    score: restricted log likelihood [nats]
    weights: what every window tells of the next one                       (N,)
    innovations: of the residuals                                          (N, C)
    used: what the fit has used up of them
    """

    scatter: Scatter
    score: float
    weights: Array
    factor: Factor
    innovations: Array
    used: Used


def rescaled(best: Judged, slopes: Array, kicks: Array | None) -> Scatter:
    """One step of the MM algorithm.

    Args:
        best: where from.
        slopes: derivative of every window's end by its start            (N, C, ndiff)
        kicks: see `carried_on`; None where the errors of the simulation have a full covariance    (C, C)
    """
    scatter, chains = best.scatter, best.factor.chains
    u = best.factor.solution(best.innovations, best.weights)
    shown_sensor, shown = squares_of_states(chains, u, slopes), u.T @ u
    expected_sensor, expected = visible(best.factor, best.weights, slopes)
    lost_sensor, lost = _lost(chains, best.used.columns, slopes)
    expected_sensor -= np.minimum(lost_sensor, MOST_USED * expected_sensor)
    sensor = scatter.sensor * np.sqrt(shown_sensor / np.maximum(expected_sensor, 1e-300))
    if kicks is None:
        process = _riccati(scatter.process, shown, _left(expected, lost))
    else:
        process = _rescaled_kicks(scatter.process, shown, expected, lost, kicks, slopes.shape[2])
    return replace(scatter, sensor=sensor, process=process)


def carried_on(slopes: Array) -> Array:
    """How errors that the simulation makes in each control step show in the steps of a window, (C, C).

    One of the step k is handed on to the step h by the derivative of a state by the one h - k steps before, and all
    steps' errors have the same variances: ndiff numbers for all steps of a window, where its ends are told apart by as
    few windows as there are. Of a window of one step it is the identity.

    Args:
        slopes: derivative of every window's end by its start            (N, C, ndiff)
    """
    n, channels, ndiff = slopes.shape
    steps = channels // ndiff
    # the windows in the middle: a contact that opens in some is no property of all
    usual = np.median(slopes.reshape(n, steps, ndiff, ndiff), axis=0)
    after = np.concatenate([np.eye(ndiff)[None], usual[:-1]])
    found = np.zeros((steps, ndiff, steps, ndiff))
    for k in range(steps):
        found[k:, :, k] = after[: steps - k]
    return found.reshape(channels, channels)


def kicked(variances: Array, kicks: Array) -> Array:
    """Covariance of what a window's simulation lacks whose errors of a step have variances (ndiff,); (C, C)."""
    each = np.tile(variances, len(kicks) // len(variances))
    return (kicks * each) @ kicks.T


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
    return squares_by_window(chains, u, slopes).sum(0)


def squares_by_window(chains: Chains, u: Array, slopes: Array) -> Array:
    """The same of the states at which each window starts, linked to the one before or not, or ends with none after it.

    Returns:
        (N, ndiff).
    """
    ends, free = _ends(chains, u, slopes)
    return at_starts(chains, u, slopes) ** 2 + np.where(free[:, :, None], ends**2, 0.0).sum(1)


def visible(factor: Factor, weights: Array, slopes: Array) -> tuple[Array, Array]:
    """What residuals show on average of the variances of the states' errors (ndiff,) and of the process (C, C)."""
    diagonal, below = factor.inverse_blocks(weights)
    ends, free = _ends(factor.chains, np.einsum("ncc->nc", diagonal), slopes)
    sensor = width_at_starts(factor.chains, diagonal, below, slopes).sum(0) + ends[free].sum(0)
    return sensor, diagonal.sum(0)


def _lost(chains: Chains, columns: Array, slopes: Array) -> tuple[Array, Array]:
    """What residuals cannot show of the states' errors (ndiff,) and of the process (C, C), as a fit has used it up.

    Args:
        chains: which window follows which.
        columns: of `Used`                                               (N, C, D)
        slopes: derivative of every window's end by its start            (N, C, ndiff)
    """
    flat = columns.swapaxes(0, 1).reshape(columns.shape[1], -1)
    sensor = np.zeros(slopes.shape[2])
    for column in np.moveaxis(columns, 2, 0):
        sensor += squares_of_states(chains, column, slopes)
    return sensor, flat @ flat.T


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


def _left(expected: Array, lost: Array) -> Array:
    """What residuals show of the process (C, C) without what a fit has used up of it, which is no more than that.

    Where both are next to all that there is, rounding may say otherwise: then no direction has more used up than is.
    """
    left = expected - MOST_USED * lost
    try:
        np.linalg.cholesky(left)
    except np.linalg.LinAlgError:
        size = np.sqrt(np.maximum(np.diag(expected), np.finfo(np.float64).tiny))
        lower = np.linalg.cholesky(definite(expected / np.outer(size, size)))
        half = np.linalg.solve(lower, np.linalg.solve(lower, lost / np.outer(size, size)).T)
        values, vectors = np.linalg.eigh(0.5 * (half + half.T))
        root = size[:, None] * (lower @ vectors)
        return (root * (1 - MOST_USED * np.clip(values, 0.0, 1.0))) @ root.T
    return left


def _rescaled_kicks(process: Array, shown: Array, expected: Array, lost: Array, kicks: Array, ndiff: int) -> Array:
    def by_channel(matrix: Array) -> Array:
        return ((matrix @ kicks) * kicks).sum(0).reshape(-1, ndiff).sum(0)

    there = by_channel(expected)
    there -= np.minimum(by_channel(lost), MOST_USED * there)
    # the first step shows no errors but its own
    variances = np.diag(process)[:ndiff] * np.sqrt(by_channel(shown) / np.maximum(there, 1e-300))
    return kicked(variances, kicks)


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
