"""A robot's likelihood around its modes, as exponentials of quadratic functions of z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp

from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.information import inverse
from nfpde.estimation.trajectory.modes import LocalPosterior

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Quadratic:
    """log L(z) around mode j: height_j + slope_j (z - z_j) - 1/2 (z - z_j)' F_j (z - z_j); Laplace's method.

    centres: the modes z_j                                                 (J, D)
    heights: log likelihood there, up to a constant [nats]                 (J,)
    slopes: its gradient there: what the prior balances                    (J, D)
    precisions: curvature F_j of the recordings' log likelihood, negative  (J, D, D)
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
        return cls(p.means, heights, 2 * share - 1, p.fisher + p.bending)

    def log_likelihood(self, z: Array) -> Array:
        """Log likelihood at z (n, D), up to the same constant [nats], (n,)."""
        step = z[:, None] - self.centres
        squares = np.einsum("nkd,kde,nke->nk", step, self.precisions, step, optimize=True)
        terms = self.heights + np.einsum("nkd,kd->nk", step, self.slopes) - 0.5 * squares
        return np.asarray(logsumexp(terms, axis=1))

    def times(self, population: Gaussians) -> Gaussians:
        """The posterior with `population` for prior: every mode with every component, J x K Gaussians."""
        concentrations = inverse(population.covariances)
        pull = np.einsum("kde,ke->kd", concentrations, population.means)
        own = np.einsum("jde,je->jd", self.precisions, self.centres) + self.slopes
        precisions = self.precisions[:, None] + concentrations
        linear = own[:, None] + pull
        covariances = inverse(precisions)
        means = np.einsum("jkde,jke->jkd", covariances, linear)
        # log of the integral of exp(quadratic) x Gaussian: likelihood and prior at the mean, times the width there
        step, off = means - self.centres[:, None], means - population.means
        inside = (
            np.einsum("jkd,jd->jk", step, self.slopes)
            - 0.5 * np.einsum("jkd,jde,jke->jk", step, self.precisions, step, optimize=True)
            - 0.5 * np.einsum("jkd,kde,jke->jk", off, concentrations, off, optimize=True)
        )
        with np.errstate(divide="ignore"):
            logs = self.heights[:, None] + np.log(population.weights) + inside
        logs = logs + 0.5 * (np.linalg.slogdet(covariances)[1] + np.linalg.slogdet(concentrations)[1])
        d = means.shape[-1]
        logs = logs.ravel()
        weights = np.exp(logs - logs.max())
        return Gaussians(weights / weights.sum(), means.reshape(-1, d), covariances.reshape(-1, d, d))
