"""From the robots' local posteriors to the population they come from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import logsumexp

from nfpde.estimation.trajectory.modes import LocalPosterior
from nfpde.estimation.trajectory.sharpening import Kernels
from nfpde.flow import INITIAL_SCALE, GaussianMixture

Array = NDArray[np.float64]

BANDWIDTHS = np.geomspace(1e-3, 1.0, 41)
"""Candidates, in standard deviations of the robots around their mean: from a spike for each to one Gaussian for all.

A wider kernel would have more than the robots' variance, which no centre could take back.
"""

LEFT_OUT = 40
"""Robots that are left out in turn, at most."""


def prior_density(features: int) -> GaussianMixture:
    """The Gaussian closest to a uniform distribution over the box, seen in z."""
    variance = torch.full((features,), INITIAL_SCALE**2, dtype=torch.float64)
    return GaussianMixture(torch.ones(1), torch.zeros(1, features), torch.diag(variance)[None])


def smoothing_matrix(posteriors: Sequence[LocalPosterior]) -> tuple[Array, float]:
    """How far to smooth the robots' posteriors, by `Kernels`, so that they predict robots not seen.

    The kernel is diagonal, with the variances of the robots' modes (a full covariance would measure the distance
    between kinds of robot and not within one), times the squared bandwidth that maximises the leave-one-out
    likelihood: every robot's posterior mean under the smoothed mixture of all others. A maximum-likelihood population
    would be one spike per robot.

    Returns:
        The kernel's covariance (D, D), and the bandwidth; zeros for a single robot, from which nothing can be learned
        about others.
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
    """Mean over robots of the log likelihood [nats] of each one's best mode, known as it is, without it in `Kernels`.

    The robot's own covariance is added to those of the others' mixture. Of more than `LEFT_OUT` robots as many are left
    out, spread over all: the bandwidth is one number.
    """
    kernels = Kernels.of(posteriors, smoothing)
    tried = np.unique(np.linspace(0, len(posteriors) - 1, min(len(posteriors), LEFT_OUT)).astype(int))
    scores = []
    for e in tried:
        others, left_out = kernels.mixture(without=int(e)), posteriors[e]
        covariances = others.covariances + left_out.covariances[0]
        step = left_out.means[0] - others.means
        squares = np.einsum("kd,kd->k", step, np.linalg.solve(covariances, step[..., None])[..., 0])
        logs = -0.5 * (squares + np.linalg.slogdet(2 * np.pi * covariances)[1])
        scores.append(logsumexp(logs, b=others.weights))
    return float(np.mean(scores))
