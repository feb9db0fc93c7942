"""What was found of each robot, as plain values in physical units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import log_expit

from nfpde.estimation.trajectory.modes import LocalPosterior
from nfpde.estimation.trajectory.population import mixture_of
from nfpde.estimation.trajectory.problem import Problem
from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]

SAMPLES = 4000
UNIFORM_STD = 1 / np.sqrt(12.0)
"""Standard deviation of the prior, in widths of the bounds."""

AT_BOUND = 0.02
"""A mode closer to a bound than this share of the width, with mass piling up there, leans on it."""


def describe_robots(
    space: ParameterSpace, problem: Problem, posteriors: Sequence[LocalPosterior]
) -> list[dict[str, Any]]:
    """One table per robot: best value, posterior standard deviation and quantiles, Cramer-Rao bound, modes, bounds.

    `known` is the share of the prior's standard deviation that the recordings took away, 0 where they say nothing;
    `cramer_rao` is null where they do not determine the parameter at all; `leans_on` names a bound.
    """
    return [
        {
            "robot": name,
            "windows": len(problem.members[g]),
            "modes": len(p.weights),
            "weights": p.weights.tolist(),
            "parameters": _parameters(space, p),
        }
        for g, (name, p) in enumerate(zip(problem.names, posteriors, strict=True))
    ]


def _parameters(space: ParameterSpace, p: LocalPosterior) -> dict[str, dict[str, Any]]:
    z = mixture_of([p]).sample(SAMPLES, torch.Generator().manual_seed(0)).numpy()
    xi = space.to_physical(z)
    low, high = np.quantile(xi, (0.05, 0.95), axis=0)
    best = space.to_physical(p.means[0])
    bound = _standard_errors(p.fisher) * np.exp(_log_slope(space, p.means[0]))
    table = {}
    for i, parameter in enumerate(space):
        std = float(xi[:, i].std())
        share = (best[i] - parameter.low) / (parameter.high - parameter.low)
        leans = "low" if share < AT_BOUND else "high" if share > 1 - AT_BOUND else None
        table[parameter.name] = {
            "value": float(best[i]),
            "std": std,
            "5%": float(low[i]),
            "95%": float(high[i]),
            "cramer_rao": float(bound[i]) if np.isfinite(bound[i]) else None,
            "known": max(0.0, 1 - std / (UNIFORM_STD * float(space.width[i]))),
            "leans_on": leans,
            "unit": parameter.unit,
        }
    return table


def _log_slope(space: ParameterSpace, z: Array) -> Array:
    """Log of d xi / d z for every parameter, (D,)."""
    return np.log(space.width) + log_expit(z) + log_expit(-z)


def _standard_errors(information: Array) -> Array:
    """Square roots of the diagonal of the inverse; infinite where a direction without information takes part."""
    values, vectors = np.linalg.eigh(information)
    blind = values <= 1e-12 * max(float(values[-1]), 1e-300)
    inverse = np.where(blind, 0.0, 1.0 / np.where(blind, 1.0, values))
    variance = (vectors**2 * inverse).sum(1)
    return np.where(((vectors**2)[:, blind] > 1e-6).any(1), np.inf, np.sqrt(variance))
