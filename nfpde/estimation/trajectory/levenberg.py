"""Levenberg-Marquardt for many robots and starts at once, with finite differences of a batched simulator.

Each candidate minimises the negative log posterior of its robot in the unconstrained parameters z, where the uniform
prior over the box is a logistic one. Heavy-tailed noise makes it iteratively reweighted least squares.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit

from nfpde.estimation.trajectory.noise import Noise
from nfpde.estimation.trajectory.problem import Index, Problem

Array = NDArray[np.float64]

STEP, WIDEST = 1e-4, 0.02
"""Finite difference in z: far above rounding errors of double precision, far below any curvature; and the most."""

RESOLVED = 0.3
"""Finite difference for a simulator of single precision, in standard deviations of the parameter."""

FARTHEST = 20.0
"""|z| of candidates: within 2e-9 of the box's width of a bound a `STEP` moves a simulation by a thousand rounding
errors of double precision, and closer to it the differences say nothing."""

SAME = 1.0
"""Two candidates closer than this share of a posterior standard deviation in every direction are one mode."""

UNSEEN = 1e-3
"""Difference in cost that is far below what any statistic can see."""

_DAMPINGS = np.array([0.1, 1.0, 10.0])


@dataclass
class Candidates:
    """K places in parameter space, each trying to explain one robot.

    robot: which robot each explains                                       (K,)
    z: where they are                                                      (K, D)
    cost: twice the negative log posterior, up to a constant; inf: given up, as another one is there    (K,)
    residuals: of their robot's windows, not white                         K arrays (n, C)
    information: Gauss-Newton matrix of cost / 2, prior included           (K, D, D)
    data_information: Fisher's of the recordings alone: less where tails are heavy   (K, D, D)
    slopes: derivatives of the residuals by the parameters, where `linearise` kept them    K arrays (D, n, C) or None
    """

    robot: Index
    z: Array
    cost: Array
    residuals: list[Array]
    information: Array
    data_information: Array
    damping: Array = field(default_factory=lambda: np.empty(0))
    done: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, bool))
    slopes: list[Array | None] = field(default_factory=list)

    def take(self, index: Index) -> Candidates:
        """The candidates at `index`, in that order."""
        return Candidates(
            self.robot[index],
            self.z[index],
            self.cost[index],
            [self.residuals[k] for k in index],
            self.information[index],
            self.data_information[index],
            self.damping[index],
            self.done[index],
            [self.slopes[k] for k in index],
        )

    def best(self, robots: int) -> Index:
        """Index of the best candidate of each of `robots` robots, (G,)."""
        order = np.lexsort((self.cost, self.robot))
        return order[np.searchsorted(self.robot[order], np.arange(robots))]

    def joined(self, others: Candidates) -> Candidates:
        """These candidates, then others."""
        return Candidates(
            np.concatenate([self.robot, others.robot]),
            np.concatenate([self.z, others.z]),
            np.concatenate([self.cost, others.cost]),
            self.residuals + others.residuals,
            np.concatenate([self.information, others.information]),
            np.concatenate([self.data_information, others.data_information]),
            np.concatenate([self.damping, others.damping]),
            np.concatenate([self.done, others.done]),
            self.slopes + others.slopes,
        )


def start(problem: Problem, z: Array, robot: Index, noise: Noise) -> Candidates:
    """Evaluate starting points z (K, D)."""
    residuals = [r for part in problem.in_parts(z, robot) for r in part]
    k, d = z.shape
    return Candidates(
        robot,
        z.copy(),
        _costs(residuals, robot, z, noise),
        residuals,
        np.tile(np.eye(d), (k, 1, 1)),
        np.zeros((k, d, d)),
        np.full(k, 1e-2),
        np.zeros(k, bool),
        [None] * k,
    )


def restart(problem: Problem, candidates: Candidates, noise: Noise) -> None:
    """Take over other starts of the windows, and another noise."""
    candidates.residuals = [r for part in problem.in_parts(candidates.z, candidates.robot) for r in part]
    reweigh(candidates, noise)


def reweigh(candidates: Candidates, noise: Noise) -> None:
    """Take over a new residual covariance."""
    candidates.cost = _costs(candidates.residuals, candidates.robot, candidates.z, noise)
    candidates.done[:] = False
    candidates.damping[:] = np.minimum(candidates.damping, 1e-2)


def improve(problem: Problem, c: Candidates, noise: Noise, iterations: int) -> None:
    """Run up to `iterations` steps of Levenberg-Marquardt on all candidates that have not converged, in place.

    One step is two calls of the simulator for everybody: D perturbed vectors for the Jacobian, then three dampings.
    A candidate has converged when its step promises to gain less than `UNSEEN`, or when it has gained just what it
    promised: the model is right there, and its minimum is reached. One that comes where a better one has converged
    goes no farther: its cost becomes inf.
    """
    d = len(problem.simulator.space)
    for _ in range(iterations):
        _give_up_doubles(c)
        active = np.flatnonzero(~c.done)
        if not len(active):
            return
        gradient = linearise(problem, c, noise, active)
        curvature = c.information[active] + _bending(c.z[active], gradient)
        scale = np.einsum("kii->ki", curvature)
        damping = c.damping[active, None] * _DAMPINGS
        # at the end of its bounds a parameter has neither data nor prior left to hold its direction
        ridge = 1e-13 * scale.max(1)[:, None, None] * np.eye(d)
        own = scale[:, None, :, None] * np.eye(d)
        matrices = curvature[:, None] + ridge[:, None] + damping[..., None, None] * own
        steps = -np.linalg.solve(matrices, np.broadcast_to(gradient[:, None, :, None], (len(active), 3, d, 1)))[..., 0]
        trials = np.clip(c.z[active, None] + np.clip(steps, -3.0, 3.0), -FARTHEST, FARTHEST)
        flat = trials.reshape(-1, d)
        residuals = [r for part in problem.in_parts(flat, np.repeat(c.robot[active], 3)) for r in part]
        costs = _costs(residuals, np.repeat(c.robot[active], 3), flat, noise).reshape(-1, 3)
        best = costs.argmin(1)
        # what the undamped quadratic model still promises, in cost
        newton = np.linalg.solve(curvature + ridge, gradient[..., None])[..., 0]
        promise = np.einsum("kd,kd->k", gradient, newton)
        for i, k in enumerate(active):
            if costs[i, best[i]] < c.cost[k]:
                left = promise[i] - (c.cost[k] - costs[i, best[i]])
                c.z[k], c.cost[k] = trials[i, best[i]], costs[i, best[i]]
                c.residuals[k] = residuals[3 * i + best[i]]
                c.damping[k] = max(damping[i, best[i]] * 0.5, 1e-10)
                c.done[k] = promise[i] < UNSEEN or abs(left) < UNSEEN
            else:
                c.damping[k] *= 10.0
                c.done[k] = promise[i] < UNSEEN or c.damping[k] > 1e8


def _bending(z: Array, gradient: Array) -> Array:
    """What the box adds to the curvature of cost / 2 at places z where its gradients are these, (K, D) to (K, D, D).

    See `box_bending` of a mode, of which there is at most 1. Beside what the recordings tell it is nothing; where they
    push against a bound it is all there is, and without it the step there would be of any length.
    """
    inward = 1 - 2 * expit(z)
    bending = np.clip((gradient + inward) * inward, 0.0, 1.0)
    return bending[:, :, None] * np.eye(z.shape[1])


def apart(c: Candidates, k: int, j: int) -> float:
    """Distance of candidate k from j, in standard deviations of j's posterior."""
    step = c.z[k] - c.z[j]
    return float(np.sqrt(step @ c.information[j] @ step))


def _give_up_doubles(c: Candidates) -> None:
    converged = c.done & np.isfinite(c.cost)
    for k in np.flatnonzero(~c.done):
        better = np.flatnonzero(converged & (c.robot == c.robot[k]) & (c.cost <= c.cost[k]))
        if any(apart(c, int(k), int(j)) <= SAME for j in better):
            c.cost[k], c.done[k] = np.inf, True


def linearise(
    problem: Problem, c: Candidates, noise: Noise, which: Index, *, careful: bool = False, keep: Index | None = None
) -> Array:
    """Update the information matrices of the candidates `which`; returns the gradients of cost / 2, (n, D).

    Args:
        problem: what is fitted.
        c: the candidates.
        noise: of the residuals.
        which: indices of candidates, (n,).
        careful: difference to both sides and take the smaller slope. A contact that opens or closes between two
            places is a jump, not a slope, and would pass for boundless information.
        keep: indices of candidates whose `slopes` are kept.
    """
    d = len(problem.simulator.space)
    parts = problem.parts(c.robot[which], d)
    if len(parts) > 1:
        return np.concatenate([linearise(problem, c, noise, which[p], careful=careful, keep=keep) for p in parts])
    gradient = np.empty((len(which), d))
    for i, (k, slope) in enumerate(zip(which, _derivatives(problem, c, which, careful=careful), strict=True)):
        if keep is not None and k in keep:
            c.slopes[k] = slope
        white = noise.whiten(int(c.robot[k]), np.concatenate([c.residuals[k][None], slope]))
        # the weights of this place in iteratively reweighted least squares
        white *= np.sqrt(noise.scatter.weight((white[:1] ** 2).sum(2, keepdims=True)))
        columns, white = white[1:].reshape(d, -1).T, white[0].ravel()
        sound = np.isfinite(columns).all(1) & np.isfinite(white)
        columns, white = columns[sound], white[sound]
        share = expit(c.z[k])
        squares = columns.T @ columns
        c.data_information[k] = noise.scatter.told * squares
        c.information[k] = squares + np.diag(2 * share * (1 - share))
        gradient[i] = columns.T @ white + 2 * share - 1
    return gradient


def _derivatives(problem: Problem, c: Candidates, which: Index, *, careful: bool) -> list[Array]:
    """Derivatives of the candidates' residuals by their parameters, arrays (D, n_k, C); arguments as in `linearise`."""
    steps = np.full((len(which), len(problem.simulator.space)), STEP)
    if problem.coarse:
        sharp = np.sqrt(np.einsum("kii->ki", c.information[which]))
        steps = np.clip(RESOLVED / np.maximum(sharp, 1e-300), STEP, WIDEST)
    ahead = _slopes(problem, c, which, steps)
    if not careful:
        return ahead
    behind = _slopes(problem, c, which, -steps)
    return [np.where(np.abs(a) < np.abs(b), a, b) for a, b in zip(ahead, behind, strict=True)]


def _slopes(problem: Problem, c: Candidates, which: Index, steps: Array) -> list[Array]:
    """One-sided differences of the residuals of candidates by every parameter over steps (k, D): arrays (D, n_k, C)."""
    space = problem.simulator.space
    d = len(space)
    moved = (c.z[which, None] + steps[:, :, None] * np.eye(d)).reshape(-1, d)
    there = problem.residuals(space.to_physical(moved), np.repeat(c.robot[which], d))
    return [
        (np.stack(there[i * d : (i + 1) * d]) - c.residuals[k]) / steps[i, :, None, None] for i, k in enumerate(which)
    ]


def _costs(residuals: list[Array], robot: Index, z: Array, noise: Noise) -> Array:
    prior = (log_expit(z) + log_expit(-z)).sum(1)
    return noise.totals(robot, residuals) - 2 * prior
