"""The fit by whole trajectories, from the problem to the result."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from nfpde.dataset import Dataset
from nfpde.distribution import ParameterDistribution
from nfpde.estimation.config import TrajectoryConfig
from nfpde.estimation.result import FitResult, versions
from nfpde.estimation.run import run_estimator
from nfpde.estimation.trajectory.advice import record_next
from nfpde.estimation.trajectory.cautions import cautions
from nfpde.estimation.trajectory.describe import describe_population, describe_robots
from nfpde.estimation.trajectory.flows import FlowPopulation
from nfpde.estimation.trajectory.gaussians import Gaussians, joined
from nfpde.estimation.trajectory.identify import Knowledge, describe_knowledge
from nfpde.estimation.trajectory.pool import Population
from nfpde.estimation.trajectory.population import prior_density
from nfpde.estimation.trajectory.problem import Problem
from nfpde.estimation.trajectory.residuals import channel_errors
from nfpde.estimation.trajectory.stages import TwoStages
from nfpde.flow import Density, GaussianMixture


def fit_trajectory(
    problem: Problem,
    dataset: Dataset,
    config: TrajectoryConfig,
    seed: int,
    run: dict[str, Any],
    out: Path | None,
    quiet: bool,
) -> FitResult:
    """Both stages, then both answers: the population, and the robots that made the recordings.

    Args:
        problem: windows sorted by robot.
        dataset: the recordings from which they are cut.
        config: settings.
        seed: of everything random.
        run: what must be the same for a run to go on, JSON.
        out: the run's folder; None saves nothing.
        quiet: no progress on the error stream.
    """
    estimator = TwoStages(problem, config, seed)
    counted = run_estimator(estimator, problem.simulator, dataset, run, out, quiet)
    together = estimator.together
    if together is None:
        raise RuntimeError("a finished fit has both stages")
    space = problem.simulator.space
    robots = together.robot_posteriors()
    knowledge = [Knowledge.of(space, p) for p in together.posteriors]
    steps = problem.simulator.simulated_steps
    best, scatter = np.array([p.means[0] for p in together.posteriors]), estimator.alone.noise.scatter
    values = together.values(robots)
    errors, diverged = channel_errors(problem, best, scatter)
    tells = describe_knowledge(knowledge)
    told = [row["told"] for row in tells["parameters"].values()]
    described = {
        "tells": tells,
        "record_next": record_next(problem, knowledge, together.noise),
        "residuals": errors,
    }
    counted["simulated_steps"] += problem.simulator.simulated_steps - steps
    found = {
        "converged": estimator.alone.converged,
        "cautions": cautions(problem, scatter, errors, told, loose=estimator.alone.loose),
        "noise_degrees": scatter.degrees,
        "noise_freedom": scatter.freedom if np.isfinite(scatter.freedom) else None,
        "population": describe_population(together),
        "robots": [
            row | {"diverged": n}
            for row, n in zip(describe_robots(space, problem, together, robots, values), diverged, strict=True)
        ],
        **described,
    }
    windows = problem.windows
    facts = {
        "transitions": len(windows),
        "episodes": len(set(windows.episode.tolist())) + len(windows.skipped_episodes),
        **counted,
    }
    return FitResult(
        ParameterDistribution(space, as_density(together.population)),
        ParameterDistribution(space, prior_density(len(space))),
        estimator.history,
        {**run, **facts, "versions": versions(), **found},
        ParameterDistribution(space, as_density(equal_mixture(robots))),
    )


def equal_mixture(parts: Sequence[Gaussians]) -> Gaussians:
    """The mixture of the robots' posteriors, each with the same share."""
    return joined(list(parts), np.full(len(parts), 1 / len(parts)))


def as_density(population: Population) -> Density:
    """The same as a density that can be saved."""
    if isinstance(population, FlowPopulation):
        return population.flow
    g = population.gaussians
    return GaussianMixture(*(torch.from_numpy(a) for a in (g.weights, g.means, g.covariances)))
