"""The second stage: importance samples of all robots, the population behind them, and what it tells of each robot."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from nfpde.checkpoint import flatten_state, restore_state
from nfpde.estimation.config import TrajectoryConfig
from nfpde.estimation.trajectory.compete import Competition, compete
from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.likelihood import Quadratic
from nfpde.estimation.trajectory.modes import LocalPosterior
from nfpde.estimation.trajectory.noise import Noise
from nfpde.estimation.trajectory.pool import Pool, Population, Ratios
from nfpde.estimation.trajectory.population import smoothing_matrix
from nfpde.estimation.trajectory.predicting import surely_better, with_bounds
from nfpde.estimation.trajectory.problem import Problem
from nfpde.estimation.trajectory.ridges import along_ridges, onto_ridges
from nfpde.estimation.trajectory.sampling import (
    MOST,
    corrected,
    next_proposal,
    temperature,
    tempered_proposal,
    widened,
)

Array = NDArray[np.float64]


DRAWS_IN_ALL = 20_000
"""Draws of all robots in a round from which more would change no population."""


@dataclass
class PopulationEstimator:
    """Draws, weighs and fits the population, again and again; `step` is one round for all robots.

    Args:
        problem: windows sorted by robot.
        noise: of the residuals, as learned.
        posteriors: of every robot by itself.
        config: settings.
        seed: of the draws.
    """

    problem: Problem
    noise: Noise
    posteriors: list[LocalPosterior]
    config: TrajectoryConfig
    seed: int
    iteration: int = 0
    settled: bool = False
    history: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.robots, self.features = len(self.posteriors), self.posteriors[0].means.shape[1]
        self.chains = along_ridges(self.problem, self.noise, self.posteriors)
        self.quadratics = [Quadratic.of(p) for p in self.chains]
        self.linked = [chain is not p for chain, p in zip(self.chains, self.posteriors, strict=True)]
        parts = [Gaussians(p.weights, p.means, p.covariances) for p in self.chains]
        self.local = [p if ok else p.heaviest(MOST, 1e-3) for p, ok in zip(parts, self.linked, strict=True)]
        self.smoothing, _ = smoothing_matrix(self.posteriors)
        self.rng = np.random.default_rng([self.seed, 1])
        self.pool = Pool.empty(self.robots, self.features)
        self.ratios: Ratios | None = None
        self.competition: Competition | None = None
        self.among: list[str] | None = None

    @property
    def least(self) -> float:
        """Effective draws of a robot that are enough to tell its posterior's moments."""
        return max(10.0, 1.5 * self.features)

    @property
    def draws(self) -> int:
        """Draws for every robot in a round.

        Fewer than asked for where many robots share what there is to learn, more where so few would tell no moments.
        """
        fewest = max(30, 4 * self.features)
        return max(fewest, min(self.config.draws, DRAWS_IN_ALL // self.robots))

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.settled or self.iteration >= self.config.population_rounds

    def step(self) -> dict[str, float]:
        """Draw, simulate, weigh, fit; returns the figures, which are also added to `history`."""
        started = time.perf_counter()
        before = -np.inf
        if self.competition is not None:
            before = float(self.competition.winner.scores.mean())
            self.among = self.among or self.competition.finalists
        self.pool.add(self.problem, self.noise, self._proposals(), self.draws, self.rng)
        self._weigh()
        ratios, competition = self.ratios, self.competition
        if ratios is None:
            raise RuntimeError("no ratios")
        self.iteration += 1
        figures = {
            "effective": float(np.median(ratios.effective)),
            "temperature": float(min(self._temperatures())),
        }
        rises = False
        if competition is not None:
            scores = competition.winner.scores
            figures["held_out"] = float(scores.mean())
            # more draws that change less than what robots differ by are of no use
            rises = bool(scores.mean() - before > 0.1 * scores.std(ddof=1) / np.sqrt(self.robots))
        self.settled = bool(not rises and ratios.sampled.all())
        seconds = time.perf_counter() - started
        self.history.append({"iteration": self.iteration, **figures, "seconds": seconds})
        return self.history[-1]

    @property
    def population(self) -> Population:
        """The population; of a single robot its own posterior, from which nothing can be learned about others."""
        if self.competition is None:
            return self.robot_posteriors()[0]
        return self.competition.winner.whole

    @property
    def informs(self) -> bool:
        """Whether the others surely predict a robot left out better than the bounds do, see `surely_better`."""
        return self.competition is not None and surely_better(self.competition.winner.scores)

    def robot_posteriors(self) -> list[Gaussians]:
        """Posterior of every robot; with the population of all others for prior where that predicts better."""
        ratios, competition, found = self.ratios, self.competition, []
        if ratios is None:
            raise RuntimeError("call step first")
        for g, analytic in enumerate(self.local):
            weights = ratios.box_weights(g)
            if self.informs and competition is not None:
                prior = with_bounds(competition.others_of(g), self.robots)
                analytic = self._informed(g, prior)
                weights = ratios.weights(g, prior)
            if ratios.sampled[g]:
                analytic = corrected(analytic, ratios.z[g], weights, chain=self.linked[g])
            found.append(analytic)
        return found

    def values(self, robots: list[Gaussians]) -> Array:
        """Best parameters of all robots in z (G, D): the tops of their posteriors; of ridges, on the ridge."""
        tops = np.array([found.mode() for found in robots])
        own = np.flatnonzero(self.linked)
        if len(own):
            tops[own] = onto_ridges(self.problem, self.noise, [self.posteriors[g] for g in own], own, tops[own])
        return tops

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Everything the next round depends on, as tensors and JSON."""
        tensors, layout = flatten_state("pool", self.pool.state())
        _, rng = flatten_state("rng", self.rng.bit_generator.state)
        info = {"iteration": self.iteration, "settled": self.settled, "history": list(self.history)}
        info["among"] = self.among
        return tensors, {**info, "pool": layout, "rng": rng}

    def restore(self, tensors: dict[str, Tensor], info: dict[str, Any]) -> None:
        """Go on from a `state`; nothing is simulated."""
        self.pool = Pool.restored(restore_state(info["pool"], tensors))
        self.rng.bit_generator.state = restore_state(info["rng"], {})
        self.iteration, self.settled, self.history = info["iteration"], info["settled"], list(info["history"])
        self.among = info["among"]
        if self.iteration:
            self._weigh()

    def _weigh(self) -> None:
        self.ratios = self.pool.ratios(self.quadratics, self.least)
        if self.robots > 1:
            self.competition = compete(
                self.posteriors, self.chains, self.quadratics, self.ratios, self.smoothing, self.among, self.seed
            )

    def _temperatures(self) -> list[float]:
        return [
            temperature(self.pool.log_likelihood[g] - self.pool.log_proposal(g), self.pool.z[g], self.least)
            for g in range(self.robots)
        ]

    def _proposals(self) -> list[Gaussians]:
        ratios, competition = self.ratios, self.competition
        if ratios is None:
            return [widened(p) for p in self.local]
        proposals = []
        for g, p in enumerate(self.local):
            if not ratios.sampled[g]:
                logs = self.pool.log_likelihood[g] - self.pool.log_proposal(g)
                exponent = temperature(logs, self.pool.z[g], self.least)
                proposals.append(tempered_proposal(logs, self.pool.z[g], exponent, p))
            elif competition is None:
                proposals.append(widened(p))
            else:
                others = competition.others_of(g)
                proposals.append(next_proposal(self._informed(g, others), p, others.gaussians))
        return proposals

    def _informed(self, g: int, prior: Population) -> Gaussians:
        """Robot g's posterior with a population for prior, by Laplace's method."""
        return self.quadratics[g].times(prior.gaussians).reduced(max(MOST, len(self.local[g].weights)), 1e-3)
