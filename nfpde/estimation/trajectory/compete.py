"""Which population predicts robots that it has not seen: candidates, folds, held-out likelihood."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.em import fit_mixture, spread_out
from nfpde.estimation.trajectory.flows import fit_flows
from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.information import inverse
from nfpde.estimation.trajectory.likelihood import Quadratic
from nfpde.estimation.trajectory.modes import LocalPosterior
from nfpde.estimation.trajectory.pool import Population, Ratios
from nfpde.estimation.trajectory.predicting import scores_with_bounds
from nfpde.estimation.trajectory.sharpening import Kernels

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Fitter = Callable[[Index], Gaussians]

FOLDS = 10
"""Parts into which robots are divided; each part is predicted by the population of all others."""

KERNELS = (0.2, 0.3, 0.5, 0.8)
"""Widths tried of one Gaussian a robot, in standard deviations of the robots."""

COMPONENTS, WIDTHS = (1, 2, 3, 5, 8), (0.2, 0.5)
"""Numbers of Gaussians tried for the whole population, and their widths before anything is known."""

FINALISTS = 4
"""Candidates that are fitted again after more draws, `SMOOTHED` not counted."""

MOST_KERNELS = 50
"""Robots up to which a population of one Gaussian a robot is informed by itself; its cost grows with their cube."""

SMOOTHED = "smoothed posteriors"

FLOW = "a normalizing flow"
"""Takes part from `FOLDS` robots on: the end of its training would be read off a handful else."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A way to make a population out of robots, and how well it predicts others.

    name: in words
    whole: fitted to all robots
    without: fitted to all but one fold's, for each fold
    scores: log likelihood of each robot held out, above that under the uniform box [nats]     (G,)
    """

    name: str
    whole: Population
    without: Sequence[Population]
    scores: Array


@dataclass(frozen=True, eq=False)
class Competition:
    """All candidates; the first is `SMOOTHED`."""

    candidates: Sequence[Candidate]
    fold: Index

    @property
    def winner(self) -> Candidate:
        """The one with the best held-out likelihood.

        The smoothed posteriors stay unless it gains more than the standard error of the gain over the robots. Both
        count with the bounds' share in them that one robot more than were recorded leaves to kinds unseen (Laplace's
        rule of succession): else the standard error would be that of the one robot which either predicts worst.
        """
        first = self.candidates[0]
        best = max(self.candidates, key=lambda c: float(c.scores.mean()))
        gain = scores_with_bounds(best.scores) - scores_with_bounds(first.scores)
        error = float(gain.std(ddof=1)) / np.sqrt(len(gain)) if len(gain) > 1 else np.inf
        return best if gain.mean() > error else first

    @property
    def finalists(self) -> list[str]:
        """Names of the candidates that predict best."""
        return [c.name for c in sorted(self.candidates, key=lambda c: -float(c.scores.mean()))[:FINALISTS]]

    def others_of(self, g: int) -> Population:
        """The winning population without robot g (and those of its fold)."""
        return self.winner.without[self.fold[g]]


def compete(
    posteriors: Sequence[LocalPosterior],
    chains: Sequence[LocalPosterior],
    quadratics: Sequence[Quadratic],
    ratios: Ratios,
    smoothing: Array,
    among: Collection[str] | None = None,
    seed: int = 0,
) -> Competition:
    """Fit every candidate to all robots and to all but each fold, and score it on the robots left out.

    Args:
        posteriors: of two robots or more, with the uniform prior.
        chains: the same along their ridges, see `along_ridges`.
        quadratics: their likelihoods.
        ratios: what their recordings say.
        smoothing: covariance of the kernel with which the robots' posteriors predict others best, (D, D): see
            `smoothing_matrix`.
        among: names of the candidates that take part; None for all. `SMOOTHED` always does.
        seed: of the flow's first weights and draws.
    """
    robots = len(posteriors)
    fold = np.arange(robots) % min(robots, FOLDS)
    best = np.array([p.means[0] for p in posteriors])
    spread = np.sqrt(np.maximum(best.var(0, ddof=1), 1e-12))
    blind = untold(posteriors, spread)
    # chains of more robots would take more time than their bends are worth
    shapes = chains if robots <= MOST_KERNELS else posteriors
    fitters: dict[str, Fitter] = {SMOOTHED: lambda own: _kernels(posteriors, shapes, own, smoothing).mixture()}
    if robots <= MOST_KERNELS:
        fitters[f"{SMOOTHED}, each informed by the others"] = partial(
            informed_kernels, posteriors, shapes, quadratics, smoothing=smoothing
        )
        for width in KERNELS:
            kernel = np.diag((width * spread) ** 2)
            fitters[f"a Gaussian for every robot, {width:g} of their spread wide"] = partial(
                informed_kernels, posteriors, shapes, quadratics, smoothing=kernel
            )
    least = robots - int((fold == 0).sum())
    for k in COMPONENTS:
        for width in WIDTHS if k > 1 else (1.0,):
            prior = np.diag((width * spread) ** 2) + blind
            for tied in (True, False):
                # a covariance of its own asks for more robots than numbers in it
                if k > least if tied else (k == 1 or 2 * k * len(spread) > least):
                    continue
                name = "one Gaussian"
                if k > 1:
                    shape = "one shape" if tied else "own shapes"
                    name = f"{k} Gaussians of {shape}, {width:g} of the spread wide at first"
                fitters[name] = partial(_mixture, ratios, best / spread, spread, k=k, prior=prior, tied=tied)
    parts = [np.arange(robots), *(np.flatnonzero(fold != f) for f in range(fold.max() + 1))]
    fitted: dict[str, Sequence[Population]] = {
        name: [fitter(own) for own in parts]
        for name, fitter in fitters.items()
        if among is None or name in among or name == SMOOTHED
    }
    if robots >= FOLDS and (among is None or FLOW in among):
        one = partial(_mixture, ratios, best / spread, spread, k=1, prior=np.diag(spread**2) + blind, tied=True)
        fitted[FLOW] = fit_flows(ratios, [one(own) for own in parts], parts, seed)
    candidates = []
    for name, (whole, *without) in fitted.items():
        scores = np.array([ratios.log_evidence(g, without[fold[g]]) for g in range(robots)])
        candidates.append(Candidate(name, whole, without, scores))
    return Competition(candidates, fold)


def untold(posteriors: Sequence[LocalPosterior], spread: Array) -> Array:
    """What all recordings together leave wider than the robots' modes lie apart, (D, D); zeros where they tell.

    Modes say nothing of how robots differ where no recording tells: there they all lie where the bounds' density is
    highest. A population begun as narrow as that would stay so, as no likelihood objects; it keeps the bounds' width.

    Args:
        posteriors: of the robots, with the uniform prior.
        spread: standard deviations of their modes, (D,).

    Returns:
        The covariance of a robot that tells as much as all do on average, less diag(spread^2), where it is larger.
    """
    information = np.mean([inverse(p.covariances[0]) for p in posteriors], axis=0)
    excess, directions = np.linalg.eigh(inverse(information) / np.outer(spread, spread))
    return (directions * np.maximum(excess - 1, 0)) @ directions.T * np.outer(spread, spread)


def informed_kernels(
    posteriors: Sequence[LocalPosterior],
    shapes: Sequence[LocalPosterior],
    quadratics: Sequence[Quadratic],
    robots: Index,
    smoothing: Array,
) -> Gaussians:
    """`Kernels` of posteriors that the population of the other robots informs, again and again.

    It is expectation-maximisation with a smoothed maximisation step (Silverman, Jones, Wilson, Nychka, A smoothed EM
    approach to indirect estimation problems, 1990), each robot being left out of its own prior.
    """
    kernels = _kernels(posteriors, shapes, robots, smoothing)
    if len(robots) > 1:
        for _ in range(3):
            informed = [quadratics[g].times(kernels.mixture(without=i)).reduced(8, 1e-3) for i, g in enumerate(robots)]
            kernels = Kernels.of(informed, smoothing)
    return kernels.mixture()


def _kernels(
    posteriors: Sequence[LocalPosterior], shapes: Sequence[LocalPosterior], robots: Index, smoothing: Array
) -> Kernels:
    return Kernels.of([posteriors[g] for g in robots], smoothing, [shapes[g] for g in robots])


def _mixture(
    ratios: Ratios, places: Array, spread: Array, robots: Index, *, k: int, prior: Array, tied: bool
) -> Gaussians:
    return fit_mixture(ratios, robots, spread_out(places[robots], k) * spread, prior, tied=tied)
