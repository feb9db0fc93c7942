"""Sets of mixtures of Gaussians in z, many at once: densities, draws, products with quadratic likelihoods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Gaussians:
    """A mixture of K Gaussians, as plain arrays.

    weights: shares, sum 1                                                 (K,)
    means: centres                                                         (K, D)
    covariances: symmetric, positive definite                              (K, D, D)
    """

    weights: Array
    means: Array
    covariances: Array

    def log_terms(self, z: Array) -> Array:
        """Log of every component's part of the density at z (n, D), [nats], (n, K)."""
        lower = np.linalg.cholesky(self.covariances)
        inverse = np.linalg.inv(lower)
        white = inverse @ (z - self.means[:, None]).swapaxes(1, 2)
        half_det = np.log(np.einsum("kii->ki", lower)).sum(1)
        d = self.means.shape[1]
        with np.errstate(divide="ignore"):
            constant = np.log(self.weights) - half_det - 0.5 * d * np.log(2 * np.pi)
        return constant - 0.5 * (white**2).sum(1).T

    def log_density(self, z: Array) -> Array:
        """Log density [nats] at z (n, D), (n,)."""
        return np.asarray(logsumexp(self.log_terms(z), axis=1))

    def sample(self, n: int, rng: np.random.Generator) -> Array:
        """Draw n points (n, D); every component gets its share of them to within one."""
        ends = np.cumsum(self.weights)
        places = (rng.permutation(n) + rng.random()) / n * ends[-1]
        k = np.minimum(np.searchsorted(ends, places, side="right"), len(ends) - 1)
        noise = rng.standard_normal((n, self.means.shape[1]))
        return self.means[k] + np.einsum("nij,nj->ni", np.linalg.cholesky(self.covariances)[k], noise)

    def heaviest(self, most: int, least: float = 0.0) -> Gaussians:
        """Its components of at least the weight `least`, `most` at most, heaviest first, with weights of sum 1."""
        order = np.argsort(-self.weights, kind="stable")[:most]
        order = order[(self.weights[order] >= least) | (np.arange(len(order)) == 0)]
        weights = self.weights[order]
        return Gaussians(weights / weights.sum(), self.means[order], self.covariances[order])


def joined(parts: list[Gaussians], shares: Array) -> Gaussians:
    """The mixture of mixtures, in shares (P,) of sum 1."""
    return Gaussians(
        np.concatenate([s * p.weights for s, p in zip(shares, parts, strict=True)]),
        np.concatenate([p.means for p in parts]),
        np.concatenate([p.covariances for p in parts]),
    )
