"""Parameters and errors of the starts in turn, with the noise held, until neither moves: an iterated smoother.

Each changes what the other sees: the smoother linearises at the parameters, and the parameters are fitted to windows
that start where the smoother puts them. With contacts in the recordings there are several pairs that hold each other,
and while the noise is learned too the rounds may go around between them. With the noise held, every turn is a step of
Gauss-Newton on one function (Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM Journal on Optimization
4, 1994), and two pairs can be told apart by it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.chains import Chains
from nfpde.estimation.trajectory.levenberg import UNSEEN, Candidates, improve, start
from nfpde.estimation.trajectory.noise import Noise, Scatter
from nfpde.estimation.trajectory.problem import Problem
from nfpde.estimation.trajectory.scatter import smoothed
from nfpde.estimation.trajectory.starts import start_slopes

Array = NDArray[np.float64]

TURNS = 6
"""Turns of parameters and starts, at most."""

STILL = 0.3
"""Standard deviations of its posterior that a robot's parameters move in the last turn or round, at most."""


@dataclass(frozen=True, eq=False)
class Linear:
    """Where the windows are linearised for the noise, and what each tells of the next.

    best: parameters of every robot, z                                     (G, D)
    size: typical error of a state that is tried, in units                 (ndiff,)
    weights: of the windows                                                (N,)
    errors: of the states from which they start, in units                  (N, ndiff)
    """

    best: Array
    size: Array
    weights: Array
    errors: Array

    def where(self, taken: NDArray[np.bool_], other: Linear, problem: Problem) -> Linear:
        """This one, and `other` for the robots that are `taken` (G,)."""
        best, weights, errors = self.best.copy(), self.weights.copy(), self.errors.copy()
        for g in np.flatnonzero(taken):
            own = problem.members[g]
            best[g], weights[own], errors[own] = other.best[g], other.weights[own], other.errors[own]
        return Linear(best, self.size, weights, errors)


@dataclass(frozen=True, eq=False)
class Linearised:
    """The windows, started where a `Linear` puts them.

    problem: whose residuals are those from the measured states again, were the ends linear in them
    slopes: of the windows' ends by their starts                           (N, C, ndiff)
    noise: of its residuals
    """

    problem: Problem
    slopes: Array
    noise: Noise

    @classmethod
    def at(cls, measured: Problem, linear: Linear, scatter: Scatter, chains: Chains) -> Linearised:
        """Simulates every window twice for each channel of a state."""
        started = measured.started_from(linear.errors)
        slopes = start_slopes(started, linear.best, linear.size)
        noise = Noise.of(scatter, slopes, chains, linear.weights, measured.members)
        return cls(started.grown_by(np.einsum("ncd,nd->nc", slopes, linear.errors)), slopes, noise)

    def places(self, linear: Linear) -> Candidates:
        """The robots' parameters, one candidate each."""
        return start(self.problem, linear.best, np.arange(len(linear.best)), self.noise)

    def costs(self, places: Candidates) -> Array:
        """Twice the negative log posterior of each robot's parameters with the errors of the starts integrated out.

        Comparable between places that are linearised differently, (G,).
        """
        own = np.linalg.slogdet(self.noise.whitening.own)[1]
        return places.cost - 2 * np.array([own[m].sum() for m in self.problem.members])


def settle(
    measured: Problem, linear: Linear, scatter: Scatter, chains: Chains, steps: int
) -> tuple[Linear, Linearised, bool]:
    """Turns of both until the parameters are still, and of those the likeliest for every robot.

    Args:
        measured: windows that start from the measured states.
        linear: where to begin.
        scatter: the noise, which is held.
        chains: which window follows which.
        steps: of Levenberg-Marquardt in a turn.

    Returns:
        Where every robot's likelihood is highest, the windows linearised there, and whether the last turn has left all
        of them where they were.
    """
    at = Linearised.at(measured, linear, scatter, chains)
    c, still = at.places(linear), False
    best, least = linear, at.costs(c)
    there: Linearised | None = at
    for _ in range(TURNS):
        improve(at.problem, c, at.noise, steps)
        still = farthest(c.z - linear.best, c.information) < STILL
        weights, errors, _ = smoothed(scatter, chains, at.slopes, np.concatenate(c.residuals))
        linear = Linear(c.z, linear.size, weights, errors)
        at = Linearised.at(measured, linear, scatter, chains)
        c = at.places(linear)
        costs = at.costs(c)
        if (costs < least - UNSEEN).any():
            taken = costs < least + UNSEEN
            # robots of different turns have not been linearised together
            best, there = best.where(taken, linear, measured), at if taken.all() else None
            least = np.where(taken, costs, least)
        if still:
            break
    return best, there or Linearised.at(measured, best, scatter, chains), still


def farthest(steps: Array, information: Array) -> float:
    """The longest of the robots' steps (G, D), in standard deviations of their posteriors: information (G, D, D)."""
    return float(np.sqrt(np.einsum("gd,gde,ge->g", steps, information, steps).max()))
