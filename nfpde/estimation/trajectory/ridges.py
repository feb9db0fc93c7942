"""Posteriors that are long and bent: a chain of Gaussians along what a robot's recordings do not tell.

Where only a combination of parameters is told, the likelihood is a ridge from bound to bound. In z it is bent, and the
sharper it is the sooner a straight Gaussian at its mode leaves it: of its draws only those close to the mode have any
weight, and the robot passes for known. Gaussians along the ridge, each straight over a short way, do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit
from scipy.stats import norm, qmc

from nfpde.estimation.trajectory.information import inverse, without_rounding
from nfpde.estimation.trajectory.levenberg import FARTHEST, Candidates, linearise, start
from nfpde.estimation.trajectory.modes import LocalPosterior
from nfpde.estimation.trajectory.noise import Noise
from nfpde.estimation.trajectory.problem import Problem

Array = NDArray[np.float64]

LOOSE, SHARP = 0.5, 0.1
"""Standard deviations, in the bounds' own: above the first a direction is not told, below the second it is."""

BOUNDS = 3 / np.pi**2
"""Information about z of a Gaussian as wide as the bounds are, seen in z: of a logistic density's variance."""

LINKS, FEWEST = 8, 3
"""Gaussians of all chains of a robot, and of a chain at least."""

STEPS = 5
"""Gauss-Newton steps from a straight line onto the ridge."""

LEAST = 1e-3
"""Share of a posterior below which a mode or a link has no part in it."""


def along_ridges(problem: Problem, noise: Noise, posteriors: Sequence[LocalPosterior]) -> list[LocalPosterior]:
    """Posteriors of the same robots; those that are ridges as chains, all others as they were.

    Args:
        problem: windows sorted by robot.
        noise: of the residuals, as learned.
        posteriors: of every robot, with the uniform prior.

    Returns:
        One a robot. The links of a chain are its modes: `fisher` has the information that keeps a link to its part of
        the ridge, so that all links together are the likelihood, and with the prior the posterior.
    """
    lines = [_lines(p) for p in posteriors]
    drawn = {g: own for g, own in enumerate(lines) if any(len(line.places) > 1 for line in own)}
    if not drawn:
        return list(posteriors)
    every = [line for own in drawn.values() for line in own]
    places = np.concatenate([line.places for line in every])
    window = np.concatenate([np.broadcast_to(line.window, (len(line.places), *line.window.shape)) for line in every])
    log_share = np.concatenate([line.log_share for line in every])
    robot = np.repeat(list(drawn), [sum(len(line.places) for line in own) for own in drawn.values()])
    c = _onto_ridges(problem, noise, start(problem, places, robot, noise), window)
    linearise(problem, c, noise, np.arange(len(robot)), careful=True)
    chains = {g: _chain(c, np.flatnonzero(robot == g), window, log_share) for g in drawn}
    return [chains.get(g) or p for g, p in enumerate(posteriors)]


@dataclass(frozen=True, eq=False)
class _Line:
    """Places on the straight line (or plane) through a mode that its robot's recordings do not tell.

    places: spread as the posterior is, of which the links take away their own widths; the mode alone where all is
        told, or nothing is                                                (n, D)
    window: information that keeps a link to its part of the line          (D, D)
    log_share: what a link has of the posterior on the line, over its height there    (n,)
    """

    places: Array
    window: Array
    log_share: Array

    @classmethod
    def through(cls, mode: Array, fisher: Array, links: int) -> _Line:
        """Of a mode (D,) and its information (D, D), for so many links."""
        share = expit(mode)
        prior = 2 * share * (1 - share)
        scale = np.sqrt(np.maximum(prior, BOUNDS))
        spread, vectors = np.linalg.eigh(inverse(fisher + np.diag(prior)) * np.outer(scale, scale))
        loose = spread > LOOSE**2
        if not loose.any() or spread[0] > SHARP**2 or links < FEWEST:
            return cls(mode[None], np.zeros_like(fisher), np.zeros(1))
        k = int(loose.sum())
        # spread beyond the posterior, or the product with a population as wide as the bounds would lack its ends;
        # variance of a link: what evenly spaced ones leave between them, more where they are few for many directions
        reach = 1 + 0.7 / k
        own = min(reach * links ** (-1 / k), 0.8)
        q = np.sqrt(reach) * _spread_out(links, k)
        along = vectors[:, loose] * np.sqrt(spread[loose])
        places = mode + q @ along.T / scale
        across = vectors[:, loose] / np.sqrt(spread[loose]) * np.sqrt(1 / own - 1) * scale[:, None]
        # shares of variance 1 - own around the mode, which with the links' own make 1, over the density of the places;
        # all links of a straight line have together the weight of the one Gaussian in their place
        log_share = 0.5 * (1 / reach - own / (1 - own)) * (q**2).sum(1) - np.log(links)
        log_share -= 0.5 * k * np.log(own * (1 - own) / reach)
        return cls(np.clip(places, -FARTHEST, FARTHEST), across @ across.T, log_share)


def _lines(p: LocalPosterior) -> list[_Line]:
    """One through every mode that has weight and is not, seen from the bounds, where another one is."""
    modes: list[int] = []
    for j in np.flatnonzero(p.weights >= LEAST):
        if all(np.abs(p.means[j] - p.means[i]).max() > SHARP for i in modes):
            modes.append(int(j))
    return [_Line.through(p.means[j], p.fisher[j], LINKS // len(modes)) for j in modes]


def _spread_out(n: int, k: int) -> Array:
    """Points of a standard normal distribution (n, k), even rather than random, with its mean and variances."""
    uniform = (np.arange(n)[:, None] + 0.5) / n if k == 1 else qmc.Halton(k, scramble=False).random(n + 1)[1:]
    q = norm.ppf(uniform)
    return np.asarray((q - q.mean(0)) / q.std(0), np.float64)


def _onto_ridges(problem: Problem, noise: Noise, c: Candidates, window: Array) -> Candidates:
    """Gauss-Newton steps of all links to where the recordings are most likely in their windows (K, D, D)."""
    begin, everyone, d = c.z.copy(), np.arange(len(c.z)), c.z.shape[1]

    def objective(c: Candidates) -> Array:
        step = c.z - begin
        return c.cost + 2 * (log_expit(c.z) + log_expit(-c.z)).sum(1) + np.einsum("kd,kde,ke->k", step, window, step)

    for _ in range(STEPS):
        gradient = linearise(problem, c, noise, everyone) - (2 * expit(c.z) - 1)
        gradient += np.einsum("kde,ke->kd", window, c.z - begin)
        # what sharp information leaves of a flat direction in double precision is no slope to follow
        own = np.einsum("kdd->kd", c.data_information)
        matrices = c.data_information + window + np.eye(d) * (1e-10 * own + 1e-12)[:, None]
        step = np.clip(-np.linalg.solve(matrices, gradient[..., None])[..., 0], -1.0, 1.0)
        for share in (1.0, 0.3):
            trial = start(problem, np.clip(c.z + share * step, -FARTHEST, FARTHEST), c.robot, noise)
            better = objective(trial) < objective(c)
            c = c.joined(trial).take(np.where(better, everyone + len(everyone), everyone))
            step = np.where(better[:, None], 0.0, step)
    return c


def _chain(c: Candidates, own: NDArray[np.intp], window: Array, log_share: Array) -> LocalPosterior | None:
    """The posterior of one robot's links; None where they did not find the ridge."""
    fisher = np.stack([without_rounding(f) for f in c.data_information[own]]) + window[own]
    share = expit(c.z[own])
    covariances = inverse(fisher + np.eye(share.shape[1]) * (2 * share * (1 - share))[:, None])
    logs = -0.5 * c.cost[own] + 0.5 * np.linalg.slogdet(covariances)[1] + log_share[own]
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    order = np.argsort(-weights, kind="stable")
    order = order[weights[order] >= LEAST]
    if len(order) < FEWEST:
        return None
    weights = weights[order] / weights[order].sum()
    return LocalPosterior(weights, c.z[own][order], covariances[order], fisher[order])
