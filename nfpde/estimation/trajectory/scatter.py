"""Learning the noise from what the best parameters of all robots leave unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.chains import Chains, Factor
from nfpde.estimation.trajectory.components import (
    Judged,
    at_least,
    at_starts,
    definite,
    extrapolated,
    rescaled,
    width_at_starts,
)
from nfpde.estimation.trajectory.noise import Scatter
from nfpde.estimation.trajectory.student import DEGREES, learn_student, standard_constant, tails_cost

Array = NDArray[np.float64]

WINDOWS_AT_MOST = 3000
"""Windows that the errors' sizes are learned from: more would change them by less than two per cent."""

STRETCH = 50
"""Windows of a chain that the errors' sizes are learned from together."""

ITERATIONS = 40
"""Steps towards the likeliest sizes, at most; a later call goes on from there."""

ENOUGH = 0.02
"""Gain in log likelihood [nats] of an iteration below which no statistic could tell one from the next."""


@dataclass(frozen=True, eq=False)
class Learned:
    """What `learn_shared` finds.

    scatter: the noise
    weights: what every window tells of the next one                       (N,)
    errors: expected error of the state from which each window starts, in units    (N, ndiff)
    left: standard deviation that is left of such an error                 (ndiff,)
    """

    scatter: Scatter
    weights: Array
    errors: Array
    left: Array


def learn_alike(residuals: Sequence[Array], fitted: float, floor: Array) -> Scatter:
    """Noise of residuals that are taken for independent draws; see `learn_student`."""
    found = learn_student(residuals, fitted, floor)
    half = np.linalg.inv(found.whitener)
    return Scatter(np.zeros(0), definite(half.T @ half), found.degrees)


def learn_shared(
    start: Scatter, residuals: Array, slopes: Array, chains: Chains, fitted: float, floors: tuple[Array, Array]
) -> Learned:
    """Sizes of the errors of measured states and of the simulation, by restricted maximum likelihood.

    Each iteration multiplies a variance by the root of what the residuals show of it over what it leads one to expect
    (the MM algorithm of Zhou, Hu, Qiao, Lange, MM algorithms for variance components models, 2019), with the tails'
    windows counted for less. Errors of states are independent of each other; those of the simulation are too, unless
    their correlations gain what Schwarz's criterion asks for.

    Args:
        start: where to begin; from `learn_alike` or an earlier call.
        residuals: of the best parameters; NaN where a window diverged    (N, C)
        slopes: derivative of every window's end by its start                (N, C, ndiff)
        chains: which window follows which.
        fitted: number of parameters that all residuals determine, see `determined`.
        floors: standard deviations below which no error of a state (ndiff,) and of the simulation (C,) is believed.
    """
    channels = residuals.shape[1]
    kept, part = _some(chains)
    r, g = residuals[kept], slopes[kept]
    inflation = 1 / _left(len(residuals), fitted, channels)

    def judged(scatter: Scatter, weights: Array) -> Judged:
        factor, innovations, squares = _innovations(scatter, part, g, r, weights)
        scatter, score = _tails(scatter, factor, squares, inflation, _least_scale(scatter, floors))
        return Judged(scatter, score, scatter.gain_weight(squares), factor, innovations)

    def likeliest(start: Scatter, *, full: bool) -> Judged:
        best = judged(start, np.isfinite(r).all(1).astype(float))
        best, stride = judged(best.scatter, best.weights), 1
        for _ in range(ITERATIONS):
            updated = rescaled(best, g, inflation, full=full)
            tried = judged(extrapolated(best.scatter, updated, stride, floors), best.weights)
            gain = tried.score - best.score
            if gain > 0:
                best, stride = tried, min(2 * stride, 64)
            if gain < ENOUGH:
                if stride == 1:
                    break
                stride = 1
        return best

    begin = _begin(start, g, floors)
    own = replace(begin, process=at_least(np.diag(np.diag(begin.process)), floors[1]))
    found = likeliest(own, full=False)
    scatter = found.scatter
    if len(kept) >= 5 * channels:
        whole = likeliest(begin, full=True)
        # what correlations must gain to be believed: Schwarz's criterion
        if whole.score - found.score > 0.25 * channels * (channels - 1) * np.log(len(kept)):
            scatter = whole.scatter
    return Learned(scatter, *smoothed(scatter, chains, slopes, residuals))


def smoothed(scatter: Scatter, chains: Chains, slopes: Array, residuals: Array) -> tuple[Array, Array, Array]:
    """What windows tell of the next (N,), expected errors of their starts (N, ndiff), what is left of them (ndiff,)."""
    weights = np.isfinite(residuals).all(1).astype(float)
    for _ in range(2):
        factor, innovations, squares = _innovations(scatter, chains, slopes, residuals, weights)
        weights = scatter.gain_weight(squares)
    factor, innovations, _ = _innovations(scatter, chains, slopes, residuals, weights)
    first = at_starts(chains, factor.solution(innovations, weights), slopes)
    wide = width_at_starts(chains, *factor.inverse_blocks(weights), slopes)
    left = scatter.sensor * np.maximum(1 - scatter.sensor * wide.mean(0), 0.01)
    return weights, scatter.sensor * first, np.sqrt(scatter.scale * left)


def _left(n: int, fitted: float, channels: int) -> float:
    """Share of the degrees of freedom that the fit has left over."""
    return max(n - fitted / channels, 0.1 * n) / n


def _some(chains: Chains) -> tuple[NDArray[np.intp], Chains]:
    """Windows to learn from: all, or stretches spread evenly over the recordings; and their chains, cut to stretches.

    Stretches go side by side, a long chain only one window after the other; a fiftieth of the links is little lost.
    """
    n = len(chains.linked)
    kept = np.arange(n)
    if n > WINDOWS_AT_MOST:
        starts = np.linspace(0, n - STRETCH, WINDOWS_AT_MOST // STRETCH).astype(int)
        kept = np.unique((starts[:, None] + np.arange(STRETCH)).ravel())
    linked = chains.linked[kept] & np.append(False, np.diff(kept) == 1)
    every = np.arange(len(kept))
    place = every - np.maximum.accumulate(np.where(linked, 0, every))
    return kept, Chains.of(linked & (place % STRETCH > 0))


def _begin(start: Scatter, slopes: Array, floors: tuple[Array, Array]) -> Scatter:
    """Half of each variance to the states, half to the simulation, where nothing is known yet."""
    if len(start.sensor):
        return start
    ndiff = slopes.shape[2]
    reach = 1 + (slopes[:, -ndiff:] ** 2).sum(2).mean(0)
    sensor = np.maximum(0.5 * start.scale * np.diag(start.process)[-ndiff:] / reach, floors[0] ** 2)
    return Scatter(sensor, 0.5 * start.scale * start.process, start.degrees)


def _innovations(
    scatter: Scatter, chains: Chains, slopes: Array, residuals: Array, weights: Array
) -> tuple[Factor, Array, Array]:
    """Factor, innovations (N, C), and their squares by the Gaussian core (N,), NaN where a window diverged."""
    sound = np.asarray(np.isfinite(residuals).all(1))
    factor = Factor.of(chains, *scatter.covariances(slopes), weights)
    innovations = factor.innovations(np.where(sound[:, None], residuals, 0.0))
    squares = np.einsum("ni,nij,nj->n", innovations, factor.inverse, innovations, optimize=True)
    return factor, innovations, np.where(sound, squares, np.nan)


def _least_scale(scatter: Scatter, floors: tuple[Array, Array]) -> float:
    """The smallest scale that leaves no error of a state, and no direction of the others, below its floor."""
    # the least eigenvalue by way of Cholesky's factor, in which channels of very different size keep their digits
    lower = np.linalg.cholesky(scatter.process / np.outer(floors[1], floors[1]))
    of_process = float(np.linalg.norm(np.linalg.inv(lower), 2)) ** 2
    of_sensors = floors[0] ** 2 / np.maximum(scatter.sensor, 1e-300)
    return max(of_process, float(of_sensors.max(initial=0.0)))


def _tails(scatter: Scatter, factor: Factor, squares: Array, inflation: float, least: float) -> tuple[Scatter, float]:
    """The degrees of freedom and the scale that fit the squares of the innovations best, and the log likelihood."""
    sound = np.isfinite(squares)
    m, channels = inflation * squares[sound], int(factor.spread.shape[1])
    half_det = 0.5 * np.linalg.slogdet(factor.spread[sound])[1].sum()
    best = (scatter, -np.inf)
    for degrees in DEGREES:
        scale = 1.0
        for _ in range(50):
            updated = float(((degrees + channels) / (degrees + m / scale) * m).mean() / channels)
            if abs(updated / scale - 1) < 1e-4:
                break
            scale = max(updated, least)
            if updated < least:
                break
        constant = standard_constant(degrees, channels)
        terms = constant - 0.5 * channels * np.log(scale) - 0.5 * (degrees + channels) * np.log1p(m / scale / degrees)
        score = float(terms.sum() - half_det) - tails_cost(degrees, len(m))
        if score > best[1]:
            best = (replace(scatter, degrees=float(degrees), scale=scale), score)
    return best
