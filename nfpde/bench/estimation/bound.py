"""What the recordings can tell of each robot at best: information at the true parameters, with the true noise.

It is made from the truth and from recordings without noise, and owes nothing to a fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.benchmarks.sensing import apart, channel_spread
from nfpde.dataset import Dataset, Windows
from nfpde.losses import increment_scale
from nfpde.sim import MujocoSimulator
from nfpde.truth import Truth

Array = NDArray[np.float64]

STEP = 1e-4
"""Finite difference, in widths of the bounds and in standard deviations of a channel."""

UNFELT = 1e-6
"""Changes below this, in increments over the box, are rounding errors: of a simulation over those of the step."""

PRIOR_INFORMATION = 12.0
"""Inverse variance of the uniform prior, in widths of the bounds."""


@dataclass(frozen=True, eq=False)
class Bound:
    """Cramer-Rao bounds of every robot: square roots of the diagonal of (information + prior)^-1, in widths.

    one_step: of estimates that take every transition as measured anew (E, D); None without noise, where a bound is
        zero for whatever the recordings show at all
    whole: of all estimates there can be, which may use that an error in a state enters two transitions (E, D) or None
    sensitivity: root-mean-square change of the next state, in increments, over the box: a parameter that an episode
        does not feel has 0                                                                           (E, D)
    """

    one_step: Array | None
    whole: Array | None
    sensitivity: Array
    felt: Array


def information_bound(simulator: MujocoSimulator, dataset: Dataset, truth: Truth, sigma: Array) -> Bound:
    """The bounds of a robot that moves without disturbance and whose states are measured with noise.

    A measured transition is off by e' - F e, where e and e' are the errors of its two states and F the derivative of
    the next state by the state; its covariance is S + F S F', and J' (S + F S F')^-1 J the information about the
    parameters, J being the derivative by them. Neighbours share an error: the covariance of a transition with the
    next is -S F', and the information of a whole episode is that of the block tridiagonal matrix of both. The prior
    over the box adds its inverse variance.

    Args:
        simulator: of the robot.
        dataset: recordings without noise, one episode for each robot.
        truth: true parameters of the episodes.
        sigma: standard deviation of the noise on every channel, (ndiff,).
    """
    windows = dataset.transitions()
    members = [np.flatnonzero(windows.episode == e) for e in range(len(dataset))]
    unit = increment_scale(simulator.states, windows)
    by_parameter = parameter_slopes(simulator, windows, truth.xi)
    size = np.sqrt(((by_parameter / unit[:, None]) ** 2).mean(1))
    sensitivity = np.array([np.sqrt((size[m] ** 2).mean(0)) for m in members])
    felt = np.array([(size[m] > UNFELT).mean(0) for m in members])
    if not sigma.any():
        return Bound(None, None, sensitivity, felt)
    by_state = state_slopes(simulator, windows, truth.xi, channel_spread(simulator.states, dataset))
    one_step, whole = (
        np.array([standard_errors(information(by_parameter[m], by_state[m], sigma, joint=joint)) for m in members])
        for joint in (False, True)
    )
    return Bound(one_step, whole, sensitivity, felt)


def unmoved(simulator: MujocoSimulator, dataset: Dataset, truth: Truth, parameter: int) -> Dataset:
    """The transitions that a parameter does not move at all at the true values, as recordings of their own.

    Args:
        simulator: of the robot.
        dataset: recordings without noise, one episode for each robot.
        truth: true parameters of the episodes.
        parameter: its index.

    Returns:
        Episodes of one transition, labelled with the robot whose they are.
    """
    windows = dataset.transitions()
    unit = increment_scale(simulator.states, windows)
    slopes = parameter_slopes(simulator, windows, truth.xi)[:, :, parameter] / unit
    return apart(dataset).subset(np.flatnonzero(np.sqrt((slopes**2).mean(1)) <= UNFELT).tolist())


def information(
    by_parameter: Array, by_state: Array, sigma: Array, *, joint: bool, process: Array | None = None
) -> Array:
    """Fisher information about the parameters in the transitions of one episode, (D, D).

    Args:
        by_parameter: J of every transition (T, C, D).
        by_state: F of every transition (T, C, C).
        sigma: standard deviation of the errors of a state (C,).
        joint: count what neighbours share; otherwise every transition stands alone.
        process: covariance of what else every transition is off by, on its own (C, C); None for nothing.
    """
    variance = np.diag(sigma**2)
    ends = variance if process is None else variance + process
    total = np.zeros(by_parameter.shape[2:] * 2)
    left, slope = np.zeros_like(by_parameter[0]), np.zeros_like(variance)
    for j, f in zip(by_parameter, by_state, strict=True):
        # one step of block elimination: what the transitions before this one leave unknown of it
        shared = -f @ variance if joint else 0.0 * variance
        mean = j - shared @ left
        covariance = ends + f @ variance @ f.T - shared @ slope @ shared.T
        slope = np.linalg.inv(0.5 * (covariance + covariance.T))
        left = slope @ mean
        total += mean.T @ left
    return total


def standard_errors(information: Array) -> Array:
    """Square roots of the diagonal of (information (D, D) + prior)^-1, in widths of the bounds, (D,)."""
    return np.sqrt(np.diag(np.linalg.inv(information + PRIOR_INFORMATION * np.eye(len(information)))))


def parameter_slopes(simulator: MujocoSimulator, windows: Windows, xi: Array) -> Array:
    """Derivatives of every window's end by its robot's parameters, in widths of the bounds: (N, ndiff, D)."""
    width = simulator.space.width
    steps = STEP * width * np.eye(len(width))
    n, d = len(windows), len(width)
    window = np.tile(np.arange(n), d)
    centre = simulator.rollout(xi, windows, windows.episode, np.arange(n))[:, 0]
    sides = []
    for sign in (1, -1):
        # a step that would leave the box (a robot on a bound) is taken to the other side and its sign kept
        moved = xi[None] + sign * steps[:, None]
        outside = (moved < simulator.space.low) | (moved > simulator.space.high)
        moved = np.where(outside, xi[None] - sign * steps[:, None], moved).reshape(-1, d)
        taken = np.where(outside.any(2), -sign, sign)[:, windows.episode]
        vector = (np.arange(d)[:, None] * len(xi) + windows.episode).ravel()
        ends = simulator.rollout(moved, windows, vector, window)[:, 0].reshape(d, n, -1)
        sides.append(simulator.states.difference(ends, centre[None]) / (STEP * taken[..., None]))
    return _smaller(*sides).transpose(1, 2, 0)


def state_slopes(simulator: MujocoSimulator, windows: Windows, xi: Array, spread: Array) -> Array:
    """Derivatives of every window's end by its start, both in the tangent space: (N, ndiff, ndiff)."""
    n, c = len(windows), len(spread)
    centre = simulator.rollout(xi, windows, windows.episode, np.arange(n))[:, 0]
    slopes = np.empty((n, c, c))
    for j in range(c):
        size = STEP * spread[j] if spread[j] > 0 else STEP
        sides = []
        for sign in (1, -1):
            step = np.zeros((n, c))
            step[:, j] = sign * size
            state = windows.state.copy()
            state[:, 0] = simulator.states.moved(windows.start, step)
            ends = simulator.rollout(xi, replace(windows, state=state), windows.episode, np.arange(n))[:, 0]
            sides.append(simulator.states.difference(ends, centre) / (sign * size))
        slopes[:, :, j] = _smaller(*sides)
    return slopes


def _smaller(ahead: Array, behind: Array) -> Array:
    """The smaller slope of the two sides: a contact that opens between two places is a jump and no slope."""
    return np.where(np.abs(ahead) < np.abs(behind), ahead, behind)
