"""Populations that are normalizing flows, trained on importance samples until robots left out gain no more."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.stats import norm, qmc
from torch import Tensor

from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.pool import Ratios
from nfpde.flow import Adam, Flow, build_flow

Array = NDArray[np.float64]
Index = NDArray[np.intp]

HIDDEN, TRANSFORMS = (32, 32), 4
"""Sizes of the flow: populations are learned from tens of robots, seldom from thousands."""

RATE, STEPS = 3e-3, 300
"""Of Adam; most steps of it."""

CHECK, PATIENCE, LOST = 10, 4, 1.0
"""Steps between two looks at the robots left out; training ends after as many looks without a gain, or at once where
as many nats a robot are lost."""

ROBOTS, POINTS, DRAWS = 64, 512, 32
"""In a step of training, at most: robots, draws of all of them together, draws of one."""

JUDGED, FEWEST = 4096, 4
"""Draws of all robots together by which a look judges; draws of one robot, at least."""

LOCAL, SHARE = 32, 0.5
"""Gaussians that stand for a flow where Gaussians are asked for, and the variance each has of a standard normal's."""


@dataclass(frozen=True, eq=False)
class FlowPopulation:
    """A population that is a normalizing flow.

    flow: over z, trained
    """

    flow: Flow

    def log_density(self, z: Array) -> Array:
        """Log density [nats] at z (n, D), (n,)."""
        with torch.no_grad():
            return self.flow.log_prob(torch.from_numpy(z)).numpy()

    @property
    def gaussians(self) -> Gaussians:
        """The flow as a mixture of `LOCAL` Gaussians or more: exact where it is affine, a proposal where it is bent.

        The standard normal that the flow deforms is a mixture itself, of Gaussians of variance `SHARE` around
        quasi-random places of variance 1 - `SHARE`; each is deformed by the flow's slope at its place.
        """
        return self._gaussians

    @cached_property
    def _gaussians(self) -> Gaussians:
        d = self.flow.features
        n = max(LOCAL, 1 << d.bit_length() + 1)  # a power of two, and more than there are directions
        places = norm.ppf(qmc.Sobol(d, rng=0).random(n))
        # a finite set of places has not quite the moments that it should
        places -= places.mean(0)
        lower = np.linalg.cholesky(places.T @ places / n)
        places = np.sqrt(1 - SHARE) * np.linalg.solve(lower, places.T).T
        u = torch.from_numpy(places).requires_grad_()
        z = self.flow.from_normal(u)
        slopes = torch.stack([torch.autograd.grad(z[:, i].sum(), u, retain_graph=True)[0] for i in range(d)], 1).numpy()
        return Gaussians(np.full(n, 1 / n), z.detach().numpy(), SHARE * slopes @ slopes.swapaxes(1, 2))


def fit_flows(ratios: Ratios, starts: Sequence[Gaussians], parts: Sequence[Index], seed: int) -> list[FlowPopulation]:
    """A flow for all robots and one for all but each fold, by maximum likelihood of the robots' recordings.

    Every step is one of expectation-maximisation with a gradient step for its maximisation: robots' draws are drawn
    again by their weights, and Adam climbs the mean over robots of the log of the integral of likelihood x flow
    (Takano et al., IROS 2024, Eq. 5, a robot in the place of a transition). The flows of all folds are trained side by
    side, and stop together where the robots that each has not seen are predicted no better: trained without an end
    they would become a spike on every robot.

    Args:
        ratios: what the recordings say.
        starts: one Gaussian for each part, as which its flow begins.
        parts: the robots that each flow is fitted to: all of them, then all but each fold.
        seed: of first weights and draws.

    Returns:
        A flow for each part.
    """
    flows = [_begun(start, seed) for start in starts]
    optimizers = [Adam(flow.parameters(), RATE) for flow in flows]
    rng = np.random.default_rng([seed, 2])
    drawn = _Drawn.of(ratios, starts[0])
    judging = max(FEWEST, JUDGED // len(parts[0]))
    judged = [drawn.some(np.setdiff1d(parts[0], own), judging, rng) for own in parts[1:]]
    best, score, looks = [copy.deepcopy(flow.state_dict()) for flow in flows], _score(flows[1:], judged), 0
    for step in range(1, STEPS + 1):
        for flow, optimizer, own in zip(flows, optimizers, parts, strict=True):
            robots = own if len(own) <= ROBOTS else rng.choice(own, ROBOTS, replace=False)
            loss = -_log_evidence(flow, drawn.some(robots, min(DRAWS, POINTS // len(robots)), rng)).mean()
            optimizer.step(loss)
        if step % CHECK == 0:
            now = _score(flows[1:], judged)
            looks += 1
            if now > score and _sound(flows[0]):
                best, score, looks = [copy.deepcopy(flow.state_dict()) for flow in flows], now, 0
            if looks == PATIENCE or now < score - LOST * len(parts[0]):
                break
    for flow, state in zip(flows, best, strict=True):
        flow.load_state_dict(state)
        flow.requires_grad_(False)
    return [FlowPopulation(flow) for flow in flows]


def _begun(start: Gaussians, seed: int) -> Flow:
    """A flow within about a percent of a Gaussian."""
    flow = build_flow(start.means.shape[1], hidden_features=HIDDEN, transforms=TRANSFORMS, sheared=True, seed=seed)
    flow.start_at(torch.from_numpy(start.means[0]), torch.from_numpy(start.covariances[0]))
    return flow


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Robots' draws with their posterior weights under one population for all.

    z: draws                                                               (G, n, D)
    ends: cumulated weights                                                (G, n)
    log_density: of the population that the weights hold                   (G, n)
    """

    z: Array
    ends: Array
    log_density: Array

    @classmethod
    def of(cls, ratios: Ratios, population: Gaussians) -> _Drawn:
        robots = range(len(ratios.z))
        weights = np.stack([ratios.weights(g, population) for g in robots])
        return cls(ratios.z, weights.cumsum(1), np.stack([population.log_density(ratios.z[g]) for g in robots]))

    def some(self, robots: Index, n: int, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Draw n of each of the robots by their weights: z (R, n, D), and log density there (R, n)."""
        places = (np.arange(n) + rng.random((len(robots), 1))) / n
        chosen = np.stack(
            [np.searchsorted(self.ends[g], p * self.ends[g, -1]) for g, p in zip(robots, places, strict=True)]
        )
        chosen = np.minimum(chosen, self.z.shape[1] - 1)
        return (
            torch.from_numpy(self.z[robots[:, None], chosen]),
            torch.from_numpy(self.log_density[robots[:, None], chosen]),
        )


def _log_evidence(flow: Flow, drawn: tuple[Tensor, Tensor]) -> Tensor:
    """Log likelihood of each robot's recordings under the flow, less that under `_Drawn`'s population, (R,)."""
    z, log_density = drawn
    logs = flow.log_prob(z.reshape(-1, z.shape[2])).reshape(z.shape[:2]) - log_density
    return torch.logsumexp(logs, 1)


def _sound(flow: Flow) -> bool:
    """Whether training has not broken a flow that no robot left out judges."""
    return all(bool(torch.isfinite(p).all()) for p in flow.parameters())


def _score(flows: Sequence[Flow], judged: Sequence[tuple[Tensor, Tensor]]) -> float:
    """Sum over robots of the log likelihood of their recordings under the flow that has not seen them."""
    with torch.no_grad():
        return sum(float(_log_evidence(flow, drawn).sum()) for flow, drawn in zip(flows, judged, strict=True))
