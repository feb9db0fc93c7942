"""What a population of recorded robots is worth for one more: the bounds' share in it, and whether it is believed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from nfpde.estimation.trajectory.gaussians import Gaussians, joined
from nfpde.estimation.trajectory.pool import Population, box_log_density
from nfpde.flow import INITIAL_SCALE

Array = NDArray[np.float64]

FEWEST_ROBOTS = 5
"""Robots from which on they inform each other.

Every robot's score comes from all the others, so that the scores of a few are no independent draws: those of two are
nearly one number, however well or badly that was met, and their scatter says nothing of its error.
"""

SURE = 0.95
"""Probability with which the others must predict better than the bounds do, by Student's t for so many robots."""


def surely_better(scores: Array) -> bool:
    """Whether populations surely predict robots left out better than the bounds do.

    The mean score has to exceed its standard error by the one-sided quantile of Student's t: with the scatter of five
    robots for all that is known, one standard error is exceeded by chance every fifth time.

    Args:
        scores: log likelihood of every robot under the population of the others, above that under the bounds
            [nats], (G,).
    """
    robots = len(scores)
    if robots < FEWEST_ROBOTS:
        return False
    error = float(scores.std(ddof=1)) / np.sqrt(robots)
    return bool(scores.mean() > float(student_t.ppf(SURE, robots - 1)) * error)


def scores_with_bounds(scores: Array) -> Array:
    """Scores (G,) [nats] of populations as `with_bounds` mixes them, when the bounds' own scores are 0."""
    share = bounds_share(len(scores))
    return np.logaddexp(scores + np.log1p(-share), np.log(share))


def bounds_share(robots: int) -> float:
    """What robots leave to kinds unseen: one part in G + 1, by Laplace's rule of succession."""
    return 1 / (robots + 1)


def with_bounds(population: Population, robots: int) -> WithBounds:
    """The prior of a robot whom the others inform: their population, and the uniform box in `bounds_share`.

    A robot of another kind than all others then keeps what its own recordings say.

    Args:
        population: of the others.
        robots: how many there are in all.
    """
    return WithBounds(population, bounds_share(robots))


@dataclass(frozen=True, eq=False)
class WithBounds:
    """A mixture of a population and the uniform prior over the box, seen in z; itself a `Population`.

    population: the larger part
    share: of the box, above 0 and below 1
    """

    population: Population
    share: float

    def log_density(self, z: Array) -> Array:
        """Log density [nats] at z (n, D), (n,)."""
        inside = self.population.log_density(z) + np.log1p(-self.share)
        return np.logaddexp(inside, box_log_density(z) + np.log(self.share))

    @property
    def gaussians(self) -> Gaussians:
        """The same with the Gaussian closest to the box's logistic density, 0.014 nats a parameter away from it."""
        parts = self.population.gaussians
        d = parts.means.shape[1]
        box = Gaussians(np.ones(1), np.zeros((1, d)), INITIAL_SCALE**2 * np.eye(d)[None])
        return joined([parts, box], np.array([1 - self.share, self.share]))
