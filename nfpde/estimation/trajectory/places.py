"""Places at which the search for a robot's parameters begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from nfpde.estimation.trajectory.levenberg import Candidates, start
from nfpde.estimation.trajectory.noise import Noise
from nfpde.estimation.trajectory.pool import box_log_density
from nfpde.estimation.trajectory.problem import Problem
from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]

INNER = 0.1
"""Share of the bounds' width, or of their decades, that is left out on either side."""

DECADE = 10.0
"""Ratio of two bounds on one side of zero from which most of their decades are within a tenth of their width."""

DECADES = 6.0
"""Decades below the larger bound that are searched where the other one is zero."""

DENSER = 8
"""Places that are spread over decades, for each that is spread over the width: simulated once, and most are left."""


def spread_over_width(space: ParameterSpace, count: int, seed: int) -> Array:
    """Quasi-random places in the inner part of the box, z (count, D)."""
    return space.to_unconstrained(space.low + (INNER + (1 - 2 * INNER) * _shares(space, count, seed)) * space.width)


def over_decades(space: ParameterSpace) -> NDArray[np.bool_]:
    """Whether the bounds of each parameter span a decade or more on one side of zero, (D,)."""
    near, far = _ends(space)
    return (space.low * space.high >= 0) & (np.abs(far) >= DECADE * np.abs(near))


def spread_over_decades(space: ParameterSpace, count: int, seed: int) -> Array:
    """Quasi-random places, z (count, D): spread evenly over the decades of those parameters whose bounds span them."""
    near, far = _ends(space)
    shares = INNER + (1 - 2 * INNER) * _shares(space, count, seed)
    decades = np.log10(np.abs(far) / np.maximum(np.abs(near), 10**-DECADES * np.abs(far)))
    spread = far * 10 ** (-decades * (1 - shares))
    xi = np.where(over_decades(space), spread, space.low + shares * space.width)
    return space.to_unconstrained(xi)


def better_over_decades(problem: Problem, c: Candidates, noise: Noise, count: int, seed: int) -> Candidates | None:
    """Places that explain a robot better as they are than where the search from all over the width has ended.

    Bounds like 0.01 to 1000 hold most of their decades within a hundredth of their width. Where none of the places that
    are spread over the width lies in the decade of the truth, the simulation may be the same around all of them, and
    the search ends where it began.

    Args:
        problem: windows sorted by robot.
        c: candidates that were improved.
        noise: of the residuals.
        count: candidates that are added to a robot, at most.
        seed: of the places.

    Returns:
        The places, candidates not improved; None where there are none, or no bounds span decades.
    """
    space, robots = problem.simulator.space, len(problem.members)
    if not over_decades(space).any():
        return None
    z = spread_over_decades(space, DENSER * count, seed)
    robot, every = np.repeat(np.arange(robots), len(z)), np.tile(z, (robots, 1))
    xi = space.to_physical(every)
    costs = np.concatenate([problem.costs(xi[p], robot[p], noise.whitening) for p in problem.parts(robot)])
    costs = (costs - 2 * box_log_density(every)).reshape(robots, -1)
    order = np.argsort(costs, axis=1, kind="stable")[:, :count]
    better = np.take_along_axis(costs, order, axis=1) < c.cost[c.best(robots)][:, None]
    if not better.any():
        return None
    robot, rank = np.nonzero(better)
    return start(problem, z[order[robot, rank]], robot, noise)


def _shares(space: ParameterSpace, count: int, seed: int) -> Array:
    return qmc.Sobol(len(space), rng=seed).random(1 << (count - 1).bit_length())[:count]


def _ends(space: ParameterSpace) -> tuple[Array, Array]:
    """The bounds closer to zero and farther from it, each (D,)."""
    swapped = np.abs(space.low) > np.abs(space.high)
    return np.where(swapped, space.high, space.low), np.where(swapped, space.low, space.high)
