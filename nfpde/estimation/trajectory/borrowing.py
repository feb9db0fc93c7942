"""Who tries where other robots ended: a robot stuck in a local minimum gets out of it there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from nfpde.estimation.trajectory.levenberg import SAME, Candidates, apart
from nfpde.estimation.trajectory.modes import HOPELESS

Array = NDArray[np.float64]
Index = NDArray[np.intp]

CHANCE = 0.01
"""Probability that any of the robots stands out by chance."""


def standing_out(costs: Sequence[Array], parameters: int) -> Index:
    """Robots whose recordings are explained worse than the others', beyond chance.

    Such a robot's mean cost of a window is above the median of the others' by more than its windows' scatter allows,
    and its whole cost by more than as many parameters gain by chance (Wilks): only then could another place explain
    its recordings better than noise would let the true one. One with a window that diverged (NaN) stands out.

    Args:
        costs: of every robot's windows at its best parameters, twice the negative log likelihood, G arrays (n_g,).
        parameters: numbers fitted to each robot.

    Returns:
        Their indices.
    """
    means = np.array([c.mean() for c in costs])
    spreads = np.array([c.var() / len(c) for c in costs])
    share = CHANCE / len(costs)
    worth, far = float(chi2.isf(share, parameters)), float(norm.isf(share))
    found = []
    for g, c in enumerate(costs):
        others = np.flatnonzero(np.isfinite(means) & (np.arange(len(costs)) != g))
        excess, spread = np.inf, 0.0
        if len(others) and np.isfinite(means[g]):
            excess = means[g] - np.median(means[others])
            # a median of n varies by pi / 2 as much as a mean of n
            spread = spreads[g] + 0.5 * np.pi * spreads[others].mean() / len(others)
        if excess > far * np.sqrt(spread) and excess * len(c) > worth:
            found.append(g)
    return np.array(found, np.intp)


def borrowed_from(robots: int, takers: Index, turn: int) -> tuple[Index, Index]:
    """Which robot tries where which other ended: two others for each of `takers`, other ones at every turn.

    Args:
        robots: how many there are.
        takers: indices of those that try.
        turn: 1, 2, ...

    Returns:
        The robots that try, and the ones whose places they try, each (n,).
    """
    shifts = (1 + (turn - 1) * 2 + np.arange(2)) % robots
    shifts = np.unique(shifts[shifts > 0])
    robot = np.repeat(takers, len(shifts))
    return robot, (robot + np.tile(shifts, len(takers))) % robots


def anything_new(c: Candidates, known: int) -> bool:
    """Whether a candidate after the first `known` is a mode that its robot did not have among those.

    Modes are new that are not `SAME` as a known one, and could carry weight beside the best of those.
    """
    for k in range(known, len(c.robot)):
        own = np.flatnonzero(c.robot[:known] == c.robot[k])
        if c.cost[k] < c.cost[own].min() + HOPELESS and all(apart(c, k, int(j)) > SAME for j in own):
            return True
    return False
