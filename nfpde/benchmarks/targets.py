"""The two populations of robots of the paper's experiments: a Gaussian, and five Gaussians that form an L."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from nfpde.errors import BadInput
from nfpde.parameters import ParameterSpace
from nfpde.truth import Population

Target = Literal["gaussian", "mixture"]

# In shares of the box; parameters with even and odd index take the two coordinates in turn, so that every pair of
# neighbours shows the same picture.
_GAUSSIAN_MEANS = [(0.4, 0.6)]
_GAUSSIAN_STD = 0.05
_L_MEANS = [(0.25, 0.75), (0.25, 0.5), (0.25, 0.25), (0.5, 0.25), (0.75, 0.25)]
_L_STD = 0.03


def population(space: ParameterSpace, target: Target) -> Population:
    """The population `target` over a space; the paper prints no figures, so means and widths are ours.

    gaussian: one Gaussian off the centre of the box, standard deviations 5 % of its width.
    mixture: five equal Gaussians with means on an L, standard deviations 3 % of the width.

    Raises:
        BadInput: an unknown target.
    """
    if target not in get_args(Target):
        raise BadInput(f"no target population is called {target!r}; there are: {', '.join(get_args(Target))}")
    means, std = (_GAUSSIAN_MEANS, _GAUSSIAN_STD) if target == "gaussian" else (_L_MEANS, _L_STD)
    shares = np.array([[pair[i % 2] for i in range(len(space))] for pair in means])
    covariance = np.diag((std * space.width) ** 2)
    k = len(means)
    return Population(np.full(k, 1 / k), space.low + shares * space.width, np.tile(covariance, (k, 1, 1)))


def draw_robots(space: ParameterSpace, people: Population, n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Parameters of n robots, (n, D): as equally many of each component as n allows, in random order.

    Ten robots drawn freely from five components would often miss one of them altogether.
    """
    k = len(people.weights)
    counts = np.floor(n * people.weights).astype(int)
    spare = rng.choice(k, size=n - counts.sum(), replace=False, p=people.weights) if n > counts.sum() else []
    np.add.at(counts, spare, 1)
    parts = []
    for i, count in enumerate(counts):
        one = Population(np.ones(1), people.means[i : i + 1], people.covariances[i : i + 1])
        parts.append(one.sample(int(count), space, rng))
    return rng.permutation(np.concatenate(parts))
