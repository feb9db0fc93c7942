"""Learning the noise from what the best parameters of all robots leave unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from nfpde.estimation.trajectory.chains import Chains
from nfpde.estimation.trajectory.components import (
    at_least,
    at_starts,
    carried_on,
    definite,
    kicked,
    width_at_starts,
)
from nfpde.estimation.trajectory.degrees import degrees_left
from nfpde.estimation.trajectory.freedom import Fitted
from nfpde.estimation.trajectory.likeliest import Likelihood, innovations_of
from nfpde.estimation.trajectory.noise import Scatter
from nfpde.estimation.trajectory.student import learn_student

Array = NDArray[np.float64]

WINDOWS_AT_MOST = 3000
"""Windows that the errors' sizes are learned from: more would change them by less than two per cent."""

STRETCH = 200
"""Windows of a chain that the errors' sizes are learned from together: errors of the simulation add up along it, and in
shorter ones a few that matter are not told from those of the states."""

CHANCE = 0.01
"""Probability that the errors of a simulation pass for correlated beyond what is handed on when they are not."""

ERRS, MATTERS = 0.5, 1e-3
"""Share of a channel's variance that errors of the simulation make, and their size, as a share of what the channel
changes by in a window, from which on they are worth a doubt: parameters so little off are as good as right."""

NEXT_TO_NONE = 1e-3
"""Share of the variances with which errors of the simulation begin where they are believed to be none."""


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
    start: Scatter, residuals: Array, slopes: Array, chains: Chains, fitted: Fitted, floors: tuple[Array, Array]
) -> Learned:
    """Sizes of the errors of measured states and of the simulation, by restricted maximum likelihood.

    Each iteration multiplies a variance by the root of what the residuals show of it over what it leads one to expect
    (the MM algorithm of Zhou, Hu, Qiao, Lange, MM algorithms for variance components models, 2019), with the tails'
    windows counted for less, and without what the fit has used up. Errors of states are independent of each other;
    those of the simulation are made anew in every control step and handed on, see `carried_on`, unless a covariance
    of their own for the steps of a window gains what Schwarz's criterion asks for, and chance does not give.

    Args:
        start: where to begin; from `learn_alike` or an earlier call.
        residuals: of the best parameters; NaN where a window diverged    (N, C)
        slopes: derivative of every window's end by its start                (N, C, ndiff)
        chains: which window follows which.
        fitted: what was fitted to all residuals.
        floors: standard deviations below which no error of a state (ndiff,) and of the simulation (C,) is believed.
    """
    channels, ndiff = slopes.shape[1:]
    kept, part = _some(chains)
    likelihood = Likelihood(residuals[kept], slopes[kept], part, fitted.some(kept), floors)
    kicks = carried_on(slopes[kept])
    begin = _begin(start, slopes[kept], floors)
    own = replace(begin, process=at_least(kicked(np.diag(begin.process)[:ndiff], kicks), floors[1]))
    found, freely = likelihood.likeliest(own, kicks), False
    if len(kept) >= 5 * channels:
        whole = likelihood.likeliest(begin, None)
        # what numbers more must gain to be believed: Schwarz's criterion, and what chance gives them in few windows
        more = 0.5 * channels * (channels + 1) - ndiff
        if whole.score - found.score > 0.5 * max(more * np.log(len(kept)), float(chi2.isf(CHANCE, more))):
            found, freely = whole, True
    scatter = replace(found.scatter, freedom=degrees_left(found, slopes[kept], None if freely else kicks))
    return Learned(scatter, *smoothed(scatter, chains, slopes, residuals))


def simulation_errs(scatter: Scatter, slopes: Array) -> bool:
    """Whether errors of the simulation make a part of what any channel shows that matters."""
    if not len(scatter.sensor):
        return False
    own = np.median(np.einsum("ncc->nc", scatter.covariances(slopes)[0]), axis=0)
    process = np.diag(scatter.process)
    return bool(((process > ERRS * own) & (scatter.scale * process > MATTERS**2)).any())


def sensors_alone(scatter: Scatter, slopes: Array, floors: tuple[Array, Array]) -> Scatter:
    """Noise that leaves as much in every channel, and all of it is the sensors'.

    Args:
        scatter: what leaves so much.
        slopes: derivative of every window's end by its start            (N, C, ndiff)
        floors: standard deviations below which no error of a state (ndiff,) and of the simulation (C,) is believed.
    """
    ndiff = slopes.shape[2]
    own = scatter.scale * np.median(np.einsum("ncc->nc", scatter.covariances(slopes)[0]), axis=0)
    reach = 1 + (slopes[:, -ndiff:] ** 2).sum(2).mean(0)
    sensor = np.maximum(own[-ndiff:] / reach, floors[0] ** 2)
    return Scatter(sensor, np.diag(np.maximum(NEXT_TO_NONE * own, floors[1] ** 2)))


def smoothed(scatter: Scatter, chains: Chains, slopes: Array, residuals: Array) -> tuple[Array, Array, Array]:
    """What windows tell of the next (N,), expected errors of their starts (N, ndiff), what is left of them (ndiff,)."""
    weights = np.isfinite(residuals).all(1).astype(float)
    for _ in range(2):
        factor, innovations, squares = innovations_of(scatter, chains, slopes, residuals, weights)
        weights = scatter.gain_weight(squares)
    factor, innovations, _ = innovations_of(scatter, chains, slopes, residuals, weights)
    first = at_starts(chains, factor.solution(innovations, weights), slopes)
    wide = width_at_starts(chains, *factor.inverse_blocks(weights), slopes)
    left = scatter.sensor * np.maximum(1 - scatter.sensor * wide.mean(0), 0.01)
    return weights, scatter.sensor * first, np.sqrt(scatter.scale * left)


def _some(chains: Chains) -> tuple[NDArray[np.intp], Chains]:
    """Windows to learn from: all, or stretches spread evenly over the recordings; and their chains, cut to stretches.

    Stretches go side by side, a long chain only one window after the other; one link in two hundred is little lost.
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
