"""Populations fitted to importance samples by expectation-maximisation: mixtures of few Gaussians, or one a robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.pool import Ratios

Array = NDArray[np.float64]
Index = NDArray[np.intp]

STEPS = 50
"""Most steps of expectation-maximisation."""

TOLERANCE = 1e-2
"""Gain in mean log likelihood per robot [nats] below which a step is the last."""


def fit_mixture(ratios: Ratios, robots: Index, centres: Array, prior: Array, *, tied: bool) -> Gaussians:
    """A mixture of K Gaussians that maximises the likelihood of the robots' recordings, with a prior on its shape.

    Every covariance has an inverse-Wishart prior as strong as D robots around the matrix `prior`, so that components
    of few robots do not shrink to spikes; the shares have one of half a robot per component.

    Args:
        ratios: what the recordings say.
        robots: which of them take part, (R,).
        centres: of the components at the start, (K, D).
        prior: covariance of a component before anything is known, (D, D).
        tied: whether all components have one covariance, as kinds of robot made on one line may have.

    Returns:
        The mixture.
    """
    k, d = centres.shape
    z = ratios.z[robots]
    flat = z.reshape(-1, d)
    shares, means = np.full(k, 1 / k), centres.copy()
    covariances = np.tile(prior, (k, 1, 1))
    before = -np.inf
    for _ in range(STEPS):
        mixture = Gaussians(shares, means, covariances)
        terms = mixture.log_terms(flat).reshape(*z.shape[:2], k) + ratios.log_ratio[robots][..., None]
        total = np.asarray(logsumexp(terms, axis=(1, 2)))
        if total.mean() - before < TOLERANCE:
            break
        before = float(total.mean())
        responsible = np.exp(terms - total[:, None, None]).reshape(-1, k)
        counts = responsible.sum(0)
        shares = (counts + 0.5) / (len(robots) + 0.5 * k)
        # an empty component stays where it is
        means = np.where(counts[:, None] > 1e-6, responsible.T @ flat / np.maximum(counts, 1e-6)[:, None], means)
        steps = flat - means[:, None]
        scatters = (steps * responsible.T[..., None]).swapaxes(1, 2) @ steps
        if tied:
            covariances = np.tile((scatters.sum(0) + d * prior) / (len(robots) + d), (k, 1, 1))
        else:
            covariances = (scatters + d * prior) / (counts + d)[:, None, None]
    return Gaussians(shares, means, covariances)


def spread_out(points: Array, k: int) -> Array:
    """Choose k of the points (n, D), each the farthest from those before it; the first is nearest the middle."""
    chosen = [int(((points - points.mean(0)) ** 2).sum(1).argmin())]
    distance = ((points - points[chosen[0]]) ** 2).sum(1)
    while len(chosen) < k:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(1))
    centres = points[chosen]
    for _ in range(10):  # of Lloyd's algorithm
        nearest = ((points[:, None] - centres) ** 2).sum(2).argmin(1)
        centres = np.array([points[nearest == i].mean(0) if (nearest == i).any() else centres[i] for i in range(k)])
    return centres
