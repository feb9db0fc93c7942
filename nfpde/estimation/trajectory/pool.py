"""Importance samples of every robot: drawn from mixtures, simulated, weighted by what the recording says."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_expit, logsumexp

from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.levenberg import FARTHEST
from nfpde.estimation.trajectory.likelihood import Quadratic
from nfpde.estimation.trajectory.noise import Noise
from nfpde.estimation.trajectory.problem import Problem

Array = NDArray[np.float64]


def effective(log_weights: Array) -> float:
    """Effective sample size of weights given by their logs (n,)."""
    w = np.exp(log_weights - log_weights.max())
    return float(w.sum() ** 2 / (w**2).sum())


def box_log_density(z: Array) -> Array:
    """Log density [nats] of the uniform prior over the box, seen in z (n, D): logistic, (n,)."""
    return (log_expit(z) + log_expit(-z)).sum(-1)


class Population(Protocol):
    """What robots come from: `Gaussians`, or a flow."""

    def log_density(self, z: Array) -> Array:
        """Log density [nats] at z (n, D), (n,)."""
        ...

    @property
    def gaussians(self) -> Gaussians:
        """As a mixture of Gaussians, for what needs one: products with quadratic likelihoods, proposals."""
        ...


@dataclass
class Pool:
    """Draws of all rounds together; each round has its own proposal for each robot.

    The proposal density of a draw is the mixture of all rounds' proposals in shares of their draws (the balance
    heuristic of Veach, Guibas, Optimally combining sampling techniques, 1995), so that one bad round does no harm.

    z: draws of each robot                                                 (G, n, D)
    log_likelihood: of the whole recording, up to a constant per robot     (G, n)
    rounds: number of draws and the robots' proposals, for each round
    """

    z: Array
    log_likelihood: Array
    rounds: list[tuple[int, list[Gaussians]]] = field(default_factory=list)

    @classmethod
    def empty(cls, robots: int, features: int) -> Pool:
        """No draws yet."""
        return cls(np.empty((robots, 0, features)), np.empty((robots, 0)))

    def add(
        self, problem: Problem, noise: Noise, proposals: list[Gaussians], draws: int, rng: np.random.Generator
    ) -> None:
        """Draw `draws` points for every robot from its proposal and simulate its recordings with them."""
        fresh = np.stack([p.sample(draws, rng) for p in proposals])
        robots, _, d = fresh.shape
        owner = np.repeat(np.arange(robots), draws)
        # beyond the farthest the simulation no longer changes; the draw stays where its density says that it is
        xi = problem.simulator.space.to_physical(np.clip(fresh.reshape(-1, d), -FARTHEST, FARTHEST))
        parts = problem.parts(owner)
        cost = np.concatenate([problem.costs(xi[p], owner[p], noise.whitening) for p in parts])
        log_likelihood = -0.5 * cost.reshape(robots, draws)
        self.z = np.concatenate([self.z, fresh], axis=1)
        self.log_likelihood = np.concatenate([self.log_likelihood, log_likelihood], axis=1)
        self.rounds.append((draws, proposals))

    def log_proposal(self, g: int) -> Array:
        """Log density [nats] of robot g's mixture of proposals at its draws, (n,)."""
        terms = [np.log(n) + proposals[g].log_density(self.z[g]) for n, proposals in self.rounds]
        return np.asarray(logsumexp(terms, axis=0)) - np.log(self.z.shape[1])

    def ratios(self, quadratics: list[Quadratic], least: float) -> Ratios:
        """Likelihood over proposal of all draws.

        A robot whose simulated likelihood leaves fewer than `least` effective draws (very sharp, or torn by
        contacts) takes Laplace's approximation of it instead, at the same draws.
        """
        rows, counts, sampled = [], [], []
        for g, quadratic in enumerate(quadratics):
            log_q = self.log_proposal(g)
            logs = self.log_likelihood[g] - log_q
            prior = box_log_density(self.z[g])
            count = effective(logs + prior)
            fine = count >= least
            if not fine:
                logs = quadratic.log_likelihood(self.z[g]) - log_q
            rows.append(logs - np.asarray(logsumexp(logs + prior)))
            counts.append(count)
            sampled.append(fine)
        return Ratios(self.z, np.stack(rows), np.array(counts), np.array(sampled))

    def state(self) -> dict[str, Any]:
        """As arrays, for a checkpoint."""
        rounds = [
            {
                "draws": n,
                "counts": np.array([len(p.weights) for p in proposals]),
                "weights": np.concatenate([p.weights for p in proposals]),
                "means": np.concatenate([p.means for p in proposals]),
                "covariances": np.concatenate([p.covariances for p in proposals]),
            }
            for n, proposals in self.rounds
        ]
        return {"z": self.z, "log_likelihood": self.log_likelihood, "rounds": rounds}

    @classmethod
    def restored(cls, state: dict[str, Any]) -> Pool:
        """The pool that `state` was taken of."""
        rounds = []
        for r in state["rounds"]:
            ends = np.cumsum(r["counts"])[:-1]
            parts = zip(*(np.split(r[k], ends) for k in ("weights", "means", "covariances")), strict=True)
            rounds.append((r["draws"], [Gaussians(*p) for p in parts]))
        return cls(state["z"], state["log_likelihood"], rounds)


@dataclass(frozen=True, eq=False)
class Ratios:
    """What the recordings say, at the draws: the integral of L(z) p(z) dz is the sum over draws of ratio x p(z).

    z: draws                                                               (G, n, D)
    log_ratio: log likelihood / proposal, scaled so that the box has integral 1    (G, n)
    effective: effective draws under the uniform prior                     (G,)
    sampled: whether the ratios are simulated (not Laplace's approximation)    (G,)
    """

    z: Array
    log_ratio: Array
    effective: Array
    sampled: NDArray[np.bool_]

    def log_evidence(self, g: int, population: Population) -> float:
        """Log of the likelihood of robot g's recordings under a population, less that under the uniform box [nats]."""
        return float(np.asarray(logsumexp(self.log_ratio[g] + population.log_density(self.z[g]))))

    def box_weights(self, g: int) -> Array:
        """Posterior weights of robot g's draws with the uniform prior, of sum 1, (n,)."""
        logs = self.log_ratio[g] + box_log_density(self.z[g])
        return np.exp(logs - np.asarray(logsumexp(logs)))

    def weights(self, g: int, population: Population) -> Array:
        """Posterior weights of robot g's draws with `population` for prior, of sum 1, (n,)."""
        logs = self.log_ratio[g] + population.log_density(self.z[g])
        return np.exp(logs - np.asarray(logsumexp(logs)))
