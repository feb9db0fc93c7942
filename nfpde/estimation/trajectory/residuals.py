"""How far the simulation is from the recordings in each channel, before and after the fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.noise import Scatter
from nfpde.estimation.trajectory.problem import Problem

Array = NDArray[np.float64]


def channel_errors(problem: Problem, best: Array, scatter: Scatter) -> tuple[dict[str, dict[str, float]], list[int]]:
    """Root mean square residual of every channel at the end of a window, in the recorded units.

    Args:
        problem: windows sorted by robot.
        best: parameters of every robot, z, (G, D).
        scatter: the learned noise.

    Returns:
        For each channel `before` (every parameter in the middle of its bounds) and `after`, without the windows that
        diverged, and what the errors after the fit are put down to, as standard deviations: `sensor`, the error of a
        measured state, and `simulation`, what the simulation lacks at the end of a window; and the number of windows
        of each robot that diverge at its best parameters.
    """
    robots = np.arange(len(best))
    ndiff = problem.simulator.states.ndiff
    errors, diverged = {}, []
    for name, z in (("before", np.zeros_like(best)), ("after", best)):
        squares = np.zeros(ndiff)
        count, diverged = 0, []
        for part in problem.in_parts(z, robots):
            for r in part:
                last = (r * problem.unit)[:, -ndiff:]
                sound = np.isfinite(last).all(1)
                squares += (last[sound] ** 2).sum(0)
                count += int(sound.sum())
                diverged.append(int((~sound).sum()))
        errors[name] = np.sqrt(squares / max(count, 1))
    channels, unit = problem.simulator.states.channels, problem.unit[-ndiff:]
    size = scatter.spread * unit
    errors["sensor"] = np.sqrt(scatter.scale * scatter.sensor) * size
    errors["simulation"] = np.sqrt(scatter.scale * np.diag(scatter.process)[-ndiff:]) * size
    return {c: {k: float(v[i]) for k, v in errors.items()} for i, c in enumerate(channels)}, diverged
