"""How an error in the state from which a window starts shows at its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.problem import Problem

Array = NDArray[np.float64]

SMALLEST, SMALLEST_SINGLE = 1e-6, 1e-3
"""Least error of a state that is tried, in units: above rounding in double and in single precision, below what a
contact notices."""


def start_slopes(problem: Problem, best: Array, size: Array) -> Array:
    """Derivatives of every window's end by its start at the best parameters of its robot.

    The difference is taken over one typical error to both sides: where a contact opens or closes within the error, it
    is the mean effect that counts and not the slope on one side.

    Args:
        problem: windows sorted by robot.
        best: parameters of every robot, z                                 (G, D)
        size: typical error of each channel of a state, in units           (ndiff,)

    Returns:
        In units of the residuals by units of the state, (N, C, ndiff); zero where a simulation diverged.
    """
    simulator, windows = problem.simulator, problem.windows
    states, xi = simulator.states, problem.simulator.space.to_physical(best)
    robot = np.repeat(np.arange(len(best)), [len(m) for m in problem.members])
    every, size_at_once = np.arange(len(windows)), 1 << 14
    parts = [slice(a, a + size_at_once) for a in range(0, len(windows), size_at_once)]
    step = np.maximum(size, SMALLEST_SINGLE if problem.coarse else SMALLEST)
    slopes = np.empty((len(windows), problem.channels, states.ndiff))
    for j in range(states.ndiff):
        ends = []
        for sign in (1.0, -1.0):
            move = np.zeros(states.ndiff)
            move[j] = sign * step[j] * problem.unit[j]
            state = windows.state.copy()
            state[:, 0] = states.moved(windows.start, move)
            moved = replace(windows, state=state)
            ends.append(np.concatenate([simulator.rollout(xi, moved, robot[p], every[p]) for p in parts]))
        apart = states.difference(*ends).reshape(len(windows), -1) / problem.unit
        slopes[:, :, j] = apart / (2 * step[j])
    return np.where(np.isfinite(slopes), slopes, 0.0)
