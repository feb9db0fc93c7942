"""What was found of each robot and of the population, as plain values in physical units."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import log_expit

from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.identify import UNIFORM_STD, Knowledge
from nfpde.estimation.trajectory.information import standard_errors
from nfpde.estimation.trajectory.informing import PopulationEstimator
from nfpde.estimation.trajectory.levenberg import FARTHEST
from nfpde.estimation.trajectory.problem import Problem
from nfpde.flow import GaussianMixture
from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]

SAMPLES = 4000

AT_BOUND = 0.02
"""A value closer to a bound than this share of the width may lean on it: what the bound cuts off would be small."""

PILED_UP = 3.0
"""Standard deviations from a bound within which the bound, and not the recordings, ends a posterior."""


def describe_robots(
    space: ParameterSpace, problem: Problem, together: PopulationEstimator, robots: list[Gaussians], values: Array
) -> list[dict[str, Any]]:
    """One table per robot: best value, posterior standard deviation and quantiles, Cramer-Rao bound, modes, bounds.

    `known` is the share of the prior's standard deviation that the robot's own recordings took away, 0 where they say
    nothing; `known_with_others` the same of the posterior, which the other robots inform where they predict it better
    than the bounds do; `cramer_rao` is null where the recordings do not determine the parameter at all; `leans_on`
    names a bound; `words` says it all in a few words.

    Args:
        space: the parameters.
        problem: windows sorted by robot.
        together: the finished second stage.
        robots: posteriors.
        values: best parameters in z, (G, D).
    """
    ratios = together.ratios
    if ratios is None:
        raise RuntimeError("no draws yet")
    rows = []
    found = zip(problem.names, together.posteriors, robots, values, strict=True)
    for g, (name, p, final, value) in enumerate(found):
        knowledge = Knowledge.of(space, p)
        rows.append(
            {
                "robot": name,
                "episodes": list(problem.episodes[g]),
                "windows": len(problem.members[g]),
                "modes": len(p.weights),
                "weights": p.weights.tolist(),
                "sampling": {
                    "draws": ratios.z.shape[1],
                    "effective": float(ratios.effective[g]),
                    "simulated": bool(ratios.sampled[g]),
                },
                "parameters": _parameters(space, p.means[0], p.fisher[0], final, value, knowledge),
                "combinations": [row["words"] for row in knowledge.pairs()],
            }
        )
    return rows


def describe_population(together: PopulationEstimator) -> dict[str, Any]:
    """Which population predicts robots left out best, by how much, and what else was tried."""
    c = together.competition
    if c is None:
        return {"chosen": "the only robot's own posterior", "candidates": [], "informs_robots": False}
    error = float(c.winner.scores.std(ddof=1) / np.sqrt(len(c.winner.scores)))
    return {
        "chosen": c.winner.name,
        "held_out": float(c.winner.scores.mean()),
        "held_out_error": error,
        "held_out_smoothed": float(c.candidates[0].scores.mean()),
        "informs_robots": together.informs,
        "candidates": [{"name": k.name, "held_out": float(k.scores.mean())} for k in c.candidates],
    }


def _parameters(
    space: ParameterSpace, mode: Array, fisher: Array, final: Gaussians, value: Array, knowledge: Knowledge
) -> dict[str, dict[str, Any]]:
    density = GaussianMixture(*(torch.from_numpy(a) for a in (final.weights, final.means, final.covariances)))
    xi = space.to_physical(density.sample(SAMPLES, torch.Generator().manual_seed(0)).numpy())
    low, high = np.quantile(xi, (0.05, 0.95), axis=0)
    best = space.to_physical(value)
    bound = standard_errors(fisher) * np.exp(_log_slope(space, mode))
    table = {}
    for i, parameter in enumerate(space):
        std, prior = float(xi[:, i].std()), UNIFORM_STD * float(space.width[i])
        share = (best[i] - parameter.low) / (parameter.high - parameter.low)
        leans = "low" if share < AT_BOUND else "high" if share > 1 - AT_BOUND else None
        if min(best[i] - parameter.low, parameter.high - best[i]) > PILED_UP * std:
            leans = None
        # as far as was searched: whatever its standard deviation says, it may lie farther
        if max(abs(mode[i]), abs(value[i])) >= FARTHEST:
            leans = "low" if share < 0.5 else "high"
        table[parameter.name] = {
            "value": float(best[i]),
            "std": std,
            "5%": float(low[i]),
            "95%": float(high[i]),
            "cramer_rao": float(bound[i]) if np.isfinite(bound[i]) else None,
            "known": max(0.0, 1 - float(knowledge.std[i]) / prior),
            "known_with_others": max(0.0, 1 - std / prior),
            "leans_on": leans,
            "unit": parameter.unit,
            "words": knowledge.words(i),
        }
    return table


def _log_slope(space: ParameterSpace, z: Array) -> Array:
    """Log of d xi / d z for every parameter, (D,)."""
    return np.log(space.width) + log_expit(z) + log_expit(-z)
