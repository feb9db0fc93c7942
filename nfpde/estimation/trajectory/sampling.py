"""Where to draw next for each robot, and a robot's posterior from its draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from nfpde.estimation.trajectory.gaussians import Gaussians, joined
from nfpde.estimation.trajectory.pool import box_log_density, effective

Array = NDArray[np.float64]

WIDER, DEFENSIVE = 1.2, 3.0
"""Factors on the covariances of proposals, for most draws and for a fifth of them: tails must be wider than the
posterior's, and a fifth of the draws far wider, or a few draws get all the weight."""

MOST = 8
"""Components of one robot's posterior that are kept."""

TINY = 1e-100
"""Weight of draws too small to be squared."""


def widened(posterior: Gaussians) -> Gaussians:
    """A posterior as a proposal: a little wider, with a defensive share that is much wider."""
    parts = [Gaussians(posterior.weights, posterior.means, f * posterior.covariances) for f in (WIDER, DEFENSIVE)]
    return joined(parts, np.array([0.8, 0.2]))


def next_proposal(informed: Gaussians, local: Gaussians, population: Gaussians) -> Gaussians:
    """A defensive mixture of the informed posterior (six tenths), the local one (three) and the population (one)."""
    return joined(
        [widened(informed), widened(local), population.heaviest(50)],
        np.array([0.6, 0.3, 0.1]),
    )


def temperature(log_ratio: Array, z: Array, least: float) -> float:
    """The largest exponent up to 1 on a robot's weights that leaves `least` effective draws; 1 needs no tempering."""
    logs = log_ratio + box_log_density(z)
    if effective(logs) >= least:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle * logs) >= least else (low, middle)
    return low


def tempered_proposal(log_ratio: Array, z: Array, exponent: float, local: Gaussians) -> Gaussians:
    """Moments of the tempered draws z (n, D), as a proposal for draws that need less tempering."""
    logs = exponent * (log_ratio + box_log_density(z))
    w = np.exp(logs - np.asarray(logsumexp(logs)))
    mean = w @ z
    step = z - mean
    covariance = (step.T * w) @ step
    # where the draws say little of the shape, the local posterior does
    count, d = 1 / (w**2).sum(), z.shape[1]
    covariance = (count * covariance + d * local.covariances[0]) / (count + d)
    found = Gaussians(np.ones(1), mean[None], covariance[None])
    return joined([widened(found), widened(local)], np.array([0.7, 0.3]))


def corrected(analytic: Gaussians, z: Array, weights: Array, *, chain: bool) -> Gaussians:
    """A robot's posterior, its Gaussians moved to the moments of the weighted draws that belong to each.

    Args:
        analytic: by Laplace's method.
        z: draws, (n, D).
        weights: of the draws, sum 1, (n,).
        chain: whether the Gaussians are links of one posterior, whose shares Laplace's method tells better than a few
            draws of each; it says next to nothing of how much more than the others a mode has.
    """
    terms = analytic.log_terms(z)
    responsible = np.exp(terms - np.asarray(logsumexp(terms, axis=1))[:, None]) * weights[:, None]
    shares, means, covariances = [], [], []
    d = z.shape[1]
    for k in range(len(analytic.weights)):
        r, m, c = responsible[:, k], analytic.means[k], analytic.covariances[k]
        total = float(r.sum())
        count = total**2 / float((r**2).sum()) if total > TINY else 0.0
        shares.append(total)
        if count > 2 * d:
            # draws tell the moments to one in their number, Laplace's method stands for D more of them
            found = r @ z / total
            step = z - found
            m = (count * found + d * m) / (count + d)
            c = (count * (step.T * r) @ step / total + d * c) / (count + d)
        means.append(m)
        covariances.append(c)
    if sum(shares) <= 0:
        return analytic
    found = np.array(shares) / sum(shares)
    if chain:
        count, stands_for = 1 / float((weights**2).sum()), d * len(found)
        found = (count * found + stands_for * analytic.weights) / (count + stands_for)
        return Gaussians(found, np.stack(means), np.stack(covariances))
    return Gaussians(found, np.stack(means), np.stack(covariances)).heaviest(MOST, 1e-3)
