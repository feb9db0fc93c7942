"""The softmax candidate at several temperatures, and which of them its user would take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from nfpde.dataset import Dataset
from nfpde.distribution import ParameterDistribution
from nfpde.losses import increment_scale
from nfpde.sim import MujocoSimulator

Array = NDArray[np.float64]

FACTORS = (0.1, 10.0)
"""Fixed temperatures tried, in units of the last one of a run that found its own."""

VECTORS, WINDOWS = 1000, 256
"""Parameter vectors and transitions that the marginal likelihood is estimated from."""


def score(simulator: MujocoSimulator, dataset: Dataset, distribution: ParameterDistribution, seed: int) -> float:
    """Marginal log likelihood of a transition under a distribution of robots (Eq. 5 of the paper) [nats].

    log of the mean over xi ~ p of a Gaussian density of the error, in increments, whose variance beta / 2 is the one
    that explains the transitions best: the same measure for fits of every temperature, made without the truth.
    """
    windows = dataset.transitions()
    chosen = np.random.default_rng(seed).permutation(len(windows))[:WINDOWS]
    scale = increment_scale(simulator.states, windows)
    losses = simulator.losses(distribution.sample(VECTORS, seed), windows[np.sort(chosen)], scale)
    return marginal_likelihood(losses, simulator.states.ndiff)


def marginal_likelihood(losses: Array, channels: int) -> float:
    """Mean over transitions of log mean over vectors of N(error; 0, beta / 2), at the best beta: losses (M, N)."""

    def negative(log_beta: float) -> float:
        inside = logsumexp(-losses / np.exp(log_beta), axis=0) - np.log(len(losses))
        return float(0.5 * channels * (np.log(np.pi) + log_beta) - inside.mean())

    # the best beta lies between the variance around the best vectors and that around all of them
    smallest = max(float(losses.min(0).mean()), np.finfo(float).tiny * 1e20)
    low, high = np.log(2 * smallest / channels) - 2.0, np.log(2 * losses.mean() / channels) + 2.0
    grid = np.linspace(low, high, 33)
    best = int(np.argmin([negative(b) for b in grid]))
    ends = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    found: Any = minimize_scalar(negative, bounds=ends, method="bounded")
    return -float(found.fun)


def chosen(fits: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The fit that its user would take: of the best `score`."""
    return max(fits, key=lambda f: f["score"])


def oracle(fits: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The fit closest to the true robots, which nobody who needs a fit can know."""
    return min(fits, key=lambda f: f["to_episodes"]["physical"])
