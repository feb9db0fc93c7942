"""A robot's likelihood around its modes, as exponentials of quadratic functions of z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp

from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.modes import LocalPosterior

Array = NDArray[np.float64]


def without_rounding(information: Array) -> Array:
    """An information matrix (D, D) whose eigenvalues at the size of rounding errors are zero.

    Sharp directions have 1e18 times the information of flat ones; what is left of a flat direction after adding and
    subtracting such numbers is chance, and may even be negative. The parameters are scaled to equal information first.
    """
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    values = np.where(values > 1e-12 * max(float(values[-1]), 0.0), values, 0.0)
    return (vectors * values) @ vectors.T * np.outer(size, size)


@dataclass(frozen=True, eq=False)
class Quadratic:
    """log L(z) around mode j: height_j + slope_j (z - z_j) - 1/2 (z - z_j)' F_j (z - z_j); Laplace's method.

    centres: the modes z_j                                                 (J, D)
    heights: log likelihood there, up to a constant [nats]                 (J,)
    slopes: its gradient there: what the prior balances                    (J, D)
    precisions: information F_j of the recordings                          (J, D, D)
    """

    centres: Array
    heights: Array
    slopes: Array
    precisions: Array

    @classmethod
    def of(cls, p: LocalPosterior) -> Quadratic:
        """The likelihood behind a local posterior: the prior over the box taken out again."""
        share = expit(p.means)
        # a mode's weight is likelihood x prior x width there
        log_prior = np.log(share * (1 - share)).sum(1)
        with np.errstate(divide="ignore"):
            heights = np.log(p.weights) - 0.5 * np.linalg.slogdet(p.covariances)[1] - log_prior
        return cls(p.means, heights, 2 * share - 1, np.stack([without_rounding(f) for f in p.fisher]))

    def log_likelihood(self, z: Array) -> Array:
        """Log likelihood at z (n, D), up to the same constant [nats], (n,)."""
        step = z[:, None] - self.centres
        squares = np.einsum("nkd,kde,nke->nk", step, self.precisions, step, optimize=True)
        terms = self.heights + np.einsum("nkd,kd->nk", step, self.slopes) - 0.5 * squares
        return np.asarray(logsumexp(terms, axis=1))

    def times(self, population: Gaussians) -> Gaussians:
        """The posterior with `population` for prior: every mode with every component, J x K Gaussians."""
        inverse = np.linalg.inv(population.covariances)
        pull = np.einsum("kde,ke->kd", inverse, population.means)
        own = np.einsum("jde,je->jd", self.precisions, self.centres) + self.slopes
        precisions = self.precisions[:, None] + inverse
        linear = own[:, None] + pull
        covariances = np.linalg.inv(precisions)
        covariances = 0.5 * (covariances + covariances.swapaxes(-1, -2))
        means = np.einsum("jkde,jke->jkd", covariances, linear)
        # log of the integral of exp(quadratic) x Gaussian: likelihood and prior at the mean, times the width there
        step, off = means - self.centres[:, None], means - population.means
        inside = (
            np.einsum("jkd,jd->jk", step, self.slopes)
            - 0.5 * np.einsum("jkd,jde,jke->jk", step, self.precisions, step, optimize=True)
            - 0.5 * np.einsum("jkd,kde,jke->jk", off, inverse, off, optimize=True)
        )
        with np.errstate(divide="ignore"):
            logs = self.heights[:, None] + np.log(population.weights) + inside
        logs = logs + 0.5 * (np.linalg.slogdet(covariances)[1] + np.linalg.slogdet(inverse)[1])
        d = means.shape[-1]
        logs = logs.ravel()
        weights = np.exp(logs - logs.max())
        return Gaussians(weights / weights.sum(), means.reshape(-1, d), covariances.reshape(-1, d, d))
