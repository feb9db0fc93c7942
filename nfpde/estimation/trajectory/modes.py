"""Local posteriors: the distinct modes of every robot, their weights, and Gaussians around them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from nfpde.estimation.trajectory.information import inverse, without_rounding
from nfpde.estimation.trajectory.levenberg import SAME, Candidates, apart

Array = NDArray[np.float64]

HOPELESS = 30.0
"""Cost above a robot's best from which a mode has no weight left (exp(-15))."""


def distinct(c: Candidates) -> Candidates:
    """Keep, for every robot, its best candidate and every other mode that could carry weight."""
    keep: list[int] = []
    for g in np.unique(c.robot):
        own = np.flatnonzero(c.robot == g)
        own = own[np.argsort(c.cost[own], kind="stable")]
        chosen: list[int] = []
        for k in own:
            far = all(apart(c, int(k), j) > SAME for j in chosen)
            if not chosen or (far and c.cost[k] - c.cost[own[0]] < HOPELESS):
                chosen.append(int(k))
        keep += chosen
    return c.take(np.array(keep))


def determined(c: Candidates) -> float:
    """How many parameters the recordings determine at the candidates, in all: the degrees of freedom they use up.

    The trace of what the recordings tell over that and the prior (Hastie, Tibshirani, Friedman, The Elements of
    Statistical Learning, Eq. 3.50): a parameter that the prior alone holds uses none.
    """
    priors = prior_information(c.z)
    left = inverse(np.stack([without_rounding(f) for f in c.data_information]) + priors)
    return float(c.z.size - np.einsum("kii,kii->", priors, left))


def prior_information(z: Array) -> Array:
    """Curvature of the negative log of the logistic prior at z, (K, D) to (K, D, D)."""
    share = expit(z)
    return np.eye(z.shape[1]) * (2 * share * (1 - share))[:, :, None]


def box_bending(z: Array) -> Array:
    """Curvature of the negative log likelihood at modes z that Gauss-Newton leaves out, (K, D) to (K, D, D).

    With xi = low + width s, s = sigmoid(z), the second derivative of log L by z has the term dL/dxi d2xi/dz2, which is
    dL/dz (1 - 2 s). At a mode of the posterior dL/dz balances the prior's 1 - 2 s, so that the term is -(1 - 2 s)^2:
    nothing for a parameter that is not told, next to nothing for one that is told well, and all there is for one that
    the recordings push against a bound.
    """
    return np.eye(z.shape[1]) * ((1 - 2 * expit(z)) ** 2)[:, :, None]


@dataclass(frozen=True, eq=False)
class LocalPosterior:
    """One robot's posterior in z: a mixture of Gaussians, one around every mode (Laplace's approximation).

    weights: share of each mode                                            (K,)
    means: the modes                                                       (K, D)
    covariances: inverse curvatures, prior included                        (K, D, D)
    fisher: information of the recordings alone about z, at every mode     (K, D, D)
    bending: what else the box adds to the curvature of the likelihood, see `box_bending`; zero for links of a
        ridge, which are no modes                                          (K, D, D)
    """

    weights: Array
    means: Array
    covariances: Array
    fisher: Array
    bending: Array | float = 0.0


def local_posteriors(c: Candidates, robots: int) -> list[LocalPosterior]:
    """The posterior of every robot, from its distinct modes; the best mode comes first."""
    result = []
    for g in range(robots):
        own = np.flatnonzero(c.robot == g)
        own = own[np.argsort(c.cost[own], kind="stable")]
        fisher = np.stack([without_rounding(f) for f in c.data_information[own]])
        bending = box_bending(c.z[own])
        covariances = inverse(fisher + bending + prior_information(c.z[own]))
        evidence = -0.5 * c.cost[own] + 0.5 * np.linalg.slogdet(covariances)[1]
        weights = np.exp(evidence - evidence.max())
        result.append(LocalPosterior(weights / weights.sum(), c.z[own], covariances, fisher, bending))
    return result
