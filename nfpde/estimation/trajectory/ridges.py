"""Posteriors that are long and bent: a chain of Gaussians along what a robot's recordings do not tell.

Where only a combination of parameters is told, the likelihood is a ridge from bound to bound. In z it is bent, and the
sharper it is the sooner a straight Gaussian at its mode leaves it: of its draws only those close to the mode have any
weight, and the robot passes for known. Gaussians along the ridge, each straight over a short way, do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit
from scipy.stats import norm, qmc

from nfpde.estimation.trajectory.information import inverse, softened_alike
from nfpde.estimation.trajectory.levenberg import FARTHEST, UNSEEN, Candidates, linearise, start
from nfpde.estimation.trajectory.modes import LocalPosterior, box_bending
from nfpde.estimation.trajectory.noise import Noise
from nfpde.estimation.trajectory.problem import Problem

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LOOSE, SHARP = 0.5, 0.1
"""Standard deviations, in the bounds' own: above the first a direction is not told, below the second it is."""

BOUNDS = 3 / np.pi**2
"""Information about z of a Gaussian as wide as the bounds are, seen in z: of a logistic density's variance."""

LINKS, FEWEST = 8, 3
"""Gaussians of all chains of a robot, and of a chain at least."""

MOST, IN_ALL = 64, 128
"""Gaussians of a robot whose ridge leaves so few, and of all such robots together: each costs some fifty simulations,
and a population compares those of all its robots with each other."""

HELD = 0.01
"""Standard deviations, in the bounds' own, by which a place moves along directions that are not told sharply."""

STEPS = 5
"""Gauss-Newton steps from a straight line onto the ridge."""

LEAST = 1e-3
"""Share of a posterior below which a mode or a link has no part in it."""

CLOSE = 0.5
"""Standard deviations by which a ridge may leave the end of a link, beside those that the recordings leave anyway."""

END = 3.0
"""Standard deviations to either side that a chain reaches: to the bounds, and wider than a posterior which a population
narrows."""

GAP = 0.6
"""Standard deviation of a link in ways to the next: the sum of such Gaussians is even to two thousandths."""


def along_ridges(problem: Problem, noise: Noise, posteriors: Sequence[LocalPosterior]) -> list[LocalPosterior]:
    """Posteriors of the same robots; those that are ridges as chains, all others as they were.

    How far a ridge leaves a straight link grows with the square of the link's length. Chains whose links it leaves too
    far are made again, of as many shorter links as that asks for.

    Args:
        problem: windows sorted by robot.
        noise: of the residuals, as learned.
        posteriors: of every robot, with the uniform prior.

    Returns:
        One a robot. The links of a chain are its modes: `fisher` has the information that keeps a link to its part of
        the ridge, so that all links together are the likelihood, and with the prior the posterior.
    """
    found = _chains(problem, noise, posteriors, dict.fromkeys(range(len(posteriors)), LINKS))
    bent = {g: int(np.ceil(LINKS * np.sqrt(bend / CLOSE))) for g, (_, bend) in found.items() if bend > CLOSE}
    most = min(MOST, IN_ALL // max(len(bent), 1))
    if most > LINKS:
        found |= _chains(problem, noise, posteriors, {g: min(n, most) for g, n in bent.items()})
    return [found[g][0] if g in found else p for g, p in enumerate(posteriors)]


def onto_ridges(problem: Problem, noise: Noise, posteriors: Sequence[LocalPosterior], robot: Index, z: Array) -> Array:
    """Places z (K, D) beside the ridges of robots (K,) put on them: moved in what the recordings tell sharply alone.

    The top of a mixture of straight links lies beside a bent ridge: next to it seen from the bounds, far away seen from
    what the recordings tell.
    """
    windows = []
    for p in posteriors:
        scale, spread, vectors = _directions(p.means[0], p.fisher[0])
        held = scale[:, None] * vectors[:, spread > SHARP**2]
        windows.append(held @ held.T / HELD**2)
    return _onto_ridges(problem, noise, start(problem, z, robot, noise), np.stack(windows)).z


def _chains(
    problem: Problem, noise: Noise, posteriors: Sequence[LocalPosterior], links: Mapping[int, int]
) -> dict[int, tuple[LocalPosterior, float]]:
    """Of some robots, of about so many links each, those that are ridges: the chain, and how far its links leave it."""
    lines = {g: _lines(posteriors[g], n) for g, n in links.items()}
    lines = {g: own for g, own in lines.items() if any(len(line.places) > 1 for line in own)}
    if not lines:
        return {}
    every = [line for own in lines.values() for line in own]
    sizes = [len(line.places) for line in every]
    places, log_share = (np.concatenate([getattr(line, a) for line in every]) for a in ("places", "log_share"))
    window = np.repeat([line.window for line in every], sizes, axis=0)
    of_line = np.repeat(np.arange(len(every)), sizes)
    robot = np.repeat([g for g, own in lines.items() for _ in own], sizes)
    c = _onto_ridges(problem, noise, start(problem, places, robot, noise), window)
    linearise(problem, c, noise, np.arange(len(robot)), careful=True)
    bends = [_bend(c.z[of_line == i], c.data_information[of_line == i], line) for i, line in enumerate(every)]
    found = {}
    for g in lines:
        own = np.flatnonzero(robot == g)
        chain = _chain(c, own, window, log_share)
        if chain is not None:
            found[g] = chain, max(bends[i] for i in np.unique(of_line[own]))
    return found


@dataclass(frozen=True, eq=False)
class _Line:
    """Places on the straight line (or plane) through a mode that its robot's recordings do not tell.

    places: as far as the posterior reaches; the mode alone where all is told, or nothing is    (n, D)
    window: information that keeps a link to its part of the line          (D, D)
    log_share: what a link has of the posterior on the line, over its height there    (n,)
    q: the places along the line, in the posterior's standard deviations   (n, k)
    own: variance of a link, in the same unit
    """

    places: Array
    window: Array
    log_share: Array
    q: Array
    own: float

    @classmethod
    def through(cls, mode: Array, fisher: Array, links: int) -> _Line:
        """Of a mode (D,) and its information (D, D), for so many links."""
        scale, spread, vectors = _directions(mode, fisher)
        loose = spread > LOOSE**2
        k = int(loose.sum())
        if k == 0 or spread[0] > SHARP**2 or links < FEWEST:
            return cls(mode[None], np.zeros_like(fisher), np.zeros(1), np.zeros((1, k)), 1.0)
        q, own, log_share = _along_line(links) if k == 1 else _on_plane(links, k)
        along = vectors[:, loose] * np.sqrt(spread[loose])
        places = mode + q @ along.T / scale
        across = vectors[:, loose] / np.sqrt(spread[loose]) * np.sqrt(1 / own - 1) * scale[:, None]
        return cls(np.clip(places, -FARTHEST, FARTHEST), across @ across.T, log_share, q, own)


def _directions(mode: Array, fisher: Array) -> tuple[Array, Array, Array]:
    """Root of the bounds' information (D,); variances of a posterior in their unit, ascending, and its axes (D, D)."""
    share = expit(mode)
    prior = 2 * share * (1 - share)
    scale = np.sqrt(np.maximum(prior, BOUNDS))
    curvature = fisher + box_bending(mode[None])[0] + np.diag(prior)
    spread, vectors = np.linalg.eigh(inverse(curvature) * np.outer(scale, scale))
    return scale, spread, vectors


def _lines(p: LocalPosterior, links: int) -> list[_Line]:
    """One through every mode that has weight and is not, seen from the bounds, where another one is."""
    modes: list[int] = []
    for j in np.flatnonzero(p.weights >= LEAST):
        if all(np.abs(p.means[j] - p.means[i]).max() > SHARP for i in modes):
            modes.append(int(j))
    return [_Line.through(p.means[j], p.fisher[j], links // len(modes)) for j in modes]


def _along_line(n: int) -> tuple[Array, float, Array]:
    """Places (n, 1) on a line, as of `_Line`, with the links' variance and shares: evenly, without gaps between them.

    Shares of variance 1 - own, which with the links' own make 1, so that all links of a straight line have together the
    weight of the one Gaussian in their place; each reaches `GAP` of the way to the next, where their sum is smooth.
    Fewer than `LINKS` are as wide, as they must be narrower than the posterior, and leave out its ends.
    """
    gap = 2 * END / (max(n, LINKS) - 1)
    q = gap * (np.arange(n, dtype=np.float64) - 0.5 * (n - 1))[:, None]
    own = (GAP * gap) ** 2
    return q, own, np.log(gap) - 0.5 * (q**2).sum(1) * own / (1 - own) - 0.5 * np.log(2 * np.pi * own * (1 - own))


def _on_plane(n: int, k: int) -> tuple[Array, float, Array]:
    """Places (n, k) on a plane, likewise: spread as the posterior is, but farther, and as wide as leaves no gaps."""
    # beyond the posterior, or the product with a population as wide as the bounds would lack its ends
    reach = 1 + 0.7 / k
    own = min(reach * n ** (-1 / k), 0.8)
    q = norm.ppf(qmc.Halton(k, scramble=False).random(n + 1)[1:])
    q = np.sqrt(reach) * (q - q.mean(0)) / q.std(0)
    # over the density of the places
    log_share = 0.5 * (1 / reach - own / (1 - own)) * (q**2).sum(1) - np.log(n)
    return q, own, log_share - 0.5 * k * np.log(own * (1 - own) / reach)


def _bend(z: Array, information: Array, line: _Line) -> float:
    """How far the ridge leaves a link (n, D) at the end of its standard deviation, in those that the recordings leave.

    Where the next link is, beside the straight line through this one, told by the information here, which has next to
    nothing along the ridge; and as much less as a link is shorter than the way there, squared.
    """
    if len(z) < FEWEST:
        return 0.0
    squares = ((line.q[:, None] - line.q) ** 2).sum(2) + np.diag(np.full(len(z), np.inf))
    near = squares.argmin(1)
    off = z[near] - z
    beside = np.einsum("nd,nde,ne->n", off, softened_alike(information), off)
    return line.own * float(np.sqrt(np.mean(beside / squares.min(1) ** 2)))


def _onto_ridges(problem: Problem, noise: Noise, c: Candidates, window: Array) -> Candidates:
    """Gauss-Newton steps of all links to where the recordings are most likely in their windows (K, D, D)."""
    begin, everyone, d = c.z.copy(), np.arange(len(c.z)), c.z.shape[1]
    moving = everyone

    def objective(c: Candidates, own: Index) -> Array:
        step = c.z - begin[own]
        kept = np.einsum("kd,kde,ke->k", step, window[own], step)
        return c.cost + 2 * (log_expit(c.z) + log_expit(-c.z)).sum(1) + kept

    for _ in range(STEPS):
        if not len(moving):
            break
        gradient = linearise(problem, c, noise, moving) - (2 * expit(c.z[moving]) - 1)
        gradient += np.einsum("kde,ke->kd", window[moving], (c.z - begin)[moving])
        # what sharp information leaves of a flat direction in double precision is no slope to follow
        information = c.data_information[moving]
        own = np.einsum("kdd->kd", information)
        matrices = information + window[moving] + np.eye(d) * (1e-10 * own + 1e-12)[:, None]
        newton = -np.linalg.solve(matrices, gradient[..., None])[..., 0]
        step = np.clip(newton, -1.0, 1.0)
        before = objective(c.take(moving), moving)
        best = before.copy()
        for share in (1.0, 0.3):
            trial = start(problem, np.clip(c.z[moving] + share * step, -FARTHEST, FARTHEST), c.robot[moving], noise)
            there = objective(trial, moving)
            better = there < best
            places = everyone.copy()
            places[moving[better]] = len(everyone) + np.flatnonzero(better)
            c, best = c.joined(trial).take(places), np.where(better, there, best)
            step = np.where(better[:, None], 0.0, step)
        promise = -np.einsum("kd,kd->k", gradient, newton)
        moving = moving[(best < before) & (promise > UNSEEN)]
    return c


def _chain(c: Candidates, own: Index, window: Array, log_share: Array) -> LocalPosterior | None:
    """The posterior of one robot's links; None where they did not find the ridge."""
    fisher = softened_alike(c.data_information[own]) + window[own]
    share = expit(c.z[own])
    covariances = inverse(fisher + np.eye(share.shape[1]) * (2 * share * (1 - share))[:, None])
    logs = -0.5 * c.cost[own] + 0.5 * np.linalg.slogdet(covariances)[1] + log_share[own]
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    order = np.argsort(-weights, kind="stable")
    order = order[weights[order] >= LEAST * LINKS / max(len(own), LINKS)]
    if len(order) < FEWEST:
        return None
    weights = weights[order] / weights[order].sum()
    return LocalPosterior(weights, c.z[own][order], covariances[order], fisher[order])
