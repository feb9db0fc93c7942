"""What the distance to fresh draws can tell: how much it scatters, and which distributions it rates best."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.distribution import ParameterDistribution
from nfpde.ot import emd
from nfpde.truth import Truth

Array = NDArray[np.float64]

REDRAWN = 5
"""Draws of everything that is drawn anew."""

NARROWER = (0.9, 0.8, 0.7, 0.6, 0.5)
"""Shares of its spread to which the true population is drawn."""


def redrawn(distribution: ParameterDistribution, truth: Truth, samples: int) -> list[float]:
    """Distances of a distribution to fresh draws of the true population, every time of draws of its own.

    In physical units; empty where the population is not known.
    """
    if truth.population is None:
        return []
    return [
        emd(distribution.sample(samples, seed), _fresh(truth, samples, seed)).cost for seed in range(1, REDRAWN + 1)
    ]


def yardsticks(truth: Truth, samples: int) -> dict[str, Any]:
    """Distances to fresh draws of the true population, in physical units, of what no method is needed for.

    Two sets of draws never coincide, and in many dimensions the nearest draws are far away. Draws of a narrower
    distribution are nearer to the middle, hence to all: the truth itself is not what this distance rates best.

    Returns:
        `truth`: other draws of it; `moments`: a Gaussian with the mean and the standard deviations of the robots
        that were recorded, which is what can be known of the population from them; `narrowed`: the truth, its draws
        moved toward its mean, by the share of its spread that is left. The first two are lists over draws.
    """
    if truth.population is None:
        return {"truth": [], "moments": [], "narrowed": {}}
    mean, std = truth.xi.mean(0), truth.xi.std(0, ddof=min(1, len(truth.xi) - 1))
    of_truth, of_moments = [], []
    for seed in range(1, REDRAWN + 1):
        fresh, other = _fresh(truth, samples, seed), _fresh(truth, samples, seed + REDRAWN)
        drawn = mean + std * np.random.default_rng(seed).standard_normal(other.shape)
        of_truth.append(emd(other, fresh).cost)
        of_moments.append(emd(drawn, fresh).cost)
    fresh, other = _fresh(truth, samples, 1), _fresh(truth, samples, 1 + REDRAWN)
    middle = other.mean(0)
    narrowed = {f"{s:g}": emd(middle + s * (other - middle), fresh).cost for s in NARROWER}
    return {"truth": of_truth, "moments": of_moments, "narrowed": narrowed}


def in_words(figures: dict[str, Any] | None, own: list[float], softmax: list[float]) -> list[str]:
    """What `yardsticks` and the `redrawn` of both methods say, for the reason of a failure."""
    words = []
    if own:
        beside = f", softmax at {_mean_and_std(softmax)}" if softmax else ""
        words.append(f"over {len(own)} other draws it is at {_mean_and_std(own)}{beside}")
    if figures and figures["moments"]:
        words.append(
            f"a Gaussian with the recorded robots' true mean and standard deviations is at "
            f"{_mean_and_std(figures['moments'])}"
        )
    if figures and figures["narrowed"]:
        share, least = min(figures["narrowed"].items(), key=lambda item: item[1])
        if least < np.mean(figures["truth"]):
            words.append(
                f"the distance is no judge of spread here: the truth narrowed to {share} of its own is at {least:.3g}"
            )
    return words


def _fresh(truth: Truth, samples: int, seed: int) -> Array:
    if truth.population is None:
        raise RuntimeError("the population is not known")
    return truth.population.sample(samples, truth.space, np.random.default_rng(seed))


def _mean_and_std(values: list[float]) -> str:
    return f"{np.mean(values):.3g} (standard deviation {np.std(values, ddof=1):.1g})"
