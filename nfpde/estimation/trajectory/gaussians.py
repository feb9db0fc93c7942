"""Sets of mixtures of Gaussians in z, many at once: densities, draws, products with quadratic likelihoods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from nfpde.estimation.trajectory.information import inverse

Array = NDArray[np.float64]

CLIMBS = 100
"""Steps to a mode at most."""


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

    @property
    def gaussians(self) -> Gaussians:
        """Itself: what a population of any other kind has to be approximated by."""
        return self

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

    def mode(self) -> Array:
        """Where the density is highest close to the heaviest component, (D,): from its centre uphill to the top.

        A fixed-point iteration: where the gradient is zero, a place is the mean of the centres, weighted by their
        densities there and inverse covariances (Carreira-Perpinan, Mode-finding for mixtures of Gaussian distributions,
        IEEE Transactions on Pattern Analysis and Machine Intelligence 22, 2000).
        """
        z = self.means[int(self.weights.argmax())]
        concentrations = inverse(self.covariances)
        pull = np.einsum("kij,kj->ki", concentrations, self.means)
        for _ in range(CLIMBS):
            terms = self.log_terms(z[None])[0]
            share = np.exp(terms - terms.max())
            matrix = np.tensordot(share, concentrations, 1)
            step = np.linalg.solve(matrix, share @ pull) - z
            z = z + step
            if step @ matrix @ step < 1e-6 * share.sum():
                break
        return z

    def heaviest(self, most: int, least: float = 0.0) -> Gaussians:
        """Its components of at least the weight `least`, `most` at most, heaviest first, with weights of sum 1."""
        order = np.argsort(-self.weights, kind="stable")[:most]
        order = order[(self.weights[order] >= least) | (np.arange(len(order)) == 0)]
        weights = self.weights[order]
        return Gaussians(weights / weights.sum(), self.means[order], self.covariances[order])

    def reduced(self, most: int, least: float = 0.0) -> Gaussians:
        """As many components as `heaviest` at most, each with those closer to it than to the others merged into it.

        Mean and covariance stay (but for components below the weight `least`), where leaving out the lighter ones of
        many that overlap would take away the ends.
        """
        kept = self.heaviest(len(self.weights), least)
        if len(kept.weights) <= most:
            return kept
        middle = kept.weights @ kept.means
        off = kept.means - middle
        total = np.einsum("k,kij->ij", kept.weights, kept.covariances) + (off.T * kept.weights) @ off
        white = np.linalg.solve(np.linalg.cholesky(total), off.T).T
        chosen, nearest = np.unique(((white[:, None] - white[:most]) ** 2).sum(2).argmin(1), return_inverse=True)
        member = (nearest == np.arange(len(chosen))[:, None]) * kept.weights
        weights = member.sum(1)
        share = member / weights[:, None]
        means = share @ kept.means
        off = kept.means - means[nearest]
        scatter = kept.covariances + off[:, :, None] * off[:, None]
        return Gaussians(weights, means, np.einsum("mk,kij->mij", share, scatter))


def joined(parts: list[Gaussians], shares: Array) -> Gaussians:
    """The mixture of mixtures, in shares (P,) of sum 1."""
    return Gaussians(
        np.concatenate([s * p.weights for s, p in zip(shares, parts, strict=True)]),
        np.concatenate([p.means for p in parts]),
        np.concatenate([p.covariances for p in parts]),
    )
