"""From the robots' local posteriors to the population they come from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import logsumexp

from nfpde.estimation.trajectory.modes import LocalPosterior
from nfpde.flow import INITIAL_SCALE, GaussianMixture

Array = NDArray[np.float64]

BANDWIDTHS = np.geomspace(1e-3, 3.0, 48)
"""Candidates, in standard deviations of the robots around their mean."""

LEFT_OUT = 40
"""Robots that are left out in turn, at most."""


def prior_density(features: int) -> GaussianMixture:
    """The Gaussian closest to a uniform distribution over the box, seen in z."""
    variance = torch.full((features,), INITIAL_SCALE**2, dtype=torch.float64)
    return GaussianMixture(torch.ones(1), torch.zeros(1, features), torch.diag(variance)[None])


def mixture_of(posteriors: Sequence[LocalPosterior], smoothing: Array | None = None) -> GaussianMixture:
    """The equal mixture of the robots' posteriors in z, every Gaussian widened by `smoothing` (D, D)."""
    weights = np.concatenate([p.weights for p in posteriors]) / len(posteriors)
    means = np.concatenate([p.means for p in posteriors])
    covariances = np.concatenate([p.covariances for p in posteriors])
    if smoothing is not None:
        covariances = covariances + smoothing
    return GaussianMixture(*(torch.from_numpy(a) for a in (weights, means, covariances)))


def smoothing_matrix(posteriors: Sequence[LocalPosterior]) -> tuple[Array, float]:
    """How far to widen the robots' posteriors so that they predict robots not seen.

    The kernel is diagonal, with the variances of the robots' modes (a full covariance would measure the distance
    between kinds of robot and not within one), times the squared bandwidth that maximises the leave-one-out
    likelihood: every robot's posterior mean under the smoothed mixture of all others. A maximum-likelihood population
    would be one spike per robot.

    Returns:
        The matrix to add to every covariance (D, D), and the bandwidth; zeros for a single robot, from which nothing
        can be learned about others.
    """
    d = posteriors[0].means.shape[1]
    if len(posteriors) < 2:
        return np.zeros((d, d)), 0.0
    best = np.array([p.means[0] for p in posteriors])
    kernel = np.diag(np.maximum(best.var(0, ddof=1), 1e-12))
    scores = [leave_one_out(posteriors, b * b * kernel) for b in BANDWIDTHS]
    bandwidth = float(BANDWIDTHS[int(np.argmax(scores))])
    return bandwidth**2 * kernel, bandwidth


def leave_one_out(posteriors: Sequence[LocalPosterior], smoothing: Array) -> float:
    """Mean over robots of log sum over the others of N(z_e; z_o, C_e + C_o + smoothing) / (G - 1) [nats].

    Of more than `LEFT_OUT` robots as many are left out, spread over all: the bandwidth is one number.
    """
    total = 0.0
    tried = np.unique(np.linspace(0, len(posteriors) - 1, min(len(posteriors), LEFT_OUT)).astype(int))
    for e in tried:
        left_out = posteriors[e]
        others = [o for i, o in enumerate(posteriors) if i != e]
        weights = np.concatenate([o.weights for o in others]) / len(others)
        means = np.concatenate([o.means for o in others])
        covariances = np.concatenate([o.covariances for o in others]) + left_out.covariances[0] + smoothing
        step = left_out.means[0] - means
        squares = np.einsum("kd,kd->k", step, np.linalg.solve(covariances, step[..., None])[..., 0])
        logs = -0.5 * (squares + np.linalg.slogdet(2 * np.pi * covariances)[1])
        total += float(np.asarray(logsumexp(logs, b=weights)))
    return total / len(tried)
