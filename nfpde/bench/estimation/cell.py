"""One cell: one robot, population, noise and seed; softmax and trajectory fits of the same recordings."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from nfpde.bench.estimation.bound import information_bound
from nfpde.bench.estimation.sensing import with_noise
from nfpde.bench.estimation.temperature import FACTORS, chosen, oracle, score
from nfpde.benchmarks import Target, collect, robot
from nfpde.dataset import Dataset
from nfpde.distribution import ParameterDistribution
from nfpde.estimation import FitResult, NfpdeConfig, TrajectoryConfig, fit
from nfpde.evaluate import Evaluation, evaluate
from nfpde.losses import increment_scale
from nfpde.sim import MujocoSimulator
from nfpde.truth import Truth

Array = NDArray[np.float64]
Stage = Callable[[str, Callable[[], Any]], Any]
"""Name and computation of a part of the work; gives what it computed, now or in an earlier call."""


@dataclass(frozen=True)
class Settings:
    """What is the same for all cells.

    Args:
        softmax: of every fit by softmax; `beta` is left out.
        trajectory: of the fit by trajectory.
        factors: fixed temperatures tried, in units of the one that softmax finds by itself.
        samples: of every distribution that is measured.
        episodes, steps: robots, and longest episode in control steps.
    """

    softmax: NfpdeConfig = field(default_factory=NfpdeConfig)
    trajectory: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    factors: tuple[float, ...] = FACTORS
    samples: int = 2000
    episodes: int = 10
    steps: int = 150


QUICK = Settings(
    NfpdeConfig(iterations=3, samples=50, transitions=8, transforms=2, hidden=16),
    TrajectoryConfig(starts=2, steps=4, rounds=3),
    factors=(1.0,),
    samples=200,
    episodes=3,
    steps=30,
)


@dataclass(frozen=True)
class Cell:
    """Where in the grid: `noise` in standard deviations of each channel, `seed` of recordings, noise and fits."""

    robot: str
    target: Target
    noise: float
    seed: int

    def __str__(self) -> str:
        return f"{self.robot}_{self.target}_{self.noise:g}_{self.seed}"


def measure(cell: Cell, settings: Settings, stage: Stage) -> dict[str, Any]:
    """Record, fit both ways, measure; every fit is a stage."""
    body = robot(cell.robot)
    clean, truth = collect(body, cell.target, episodes=settings.episodes, steps=settings.steps, seed=cell.seed)
    dataset, sigma = with_noise(body.model, clean, cell.noise, cell.seed)
    simulator = MujocoSimulator(body.path, body.space)
    # the first optimiser of a process loads torch's compiler: seconds that are no fit's
    torch.optim.Adam([torch.zeros(1)])
    work = _Work(cell, settings, simulator, dataset, truth)
    first = stage("softmax, own beta", lambda: work.softmax(None))
    fits = [first]
    for factor in settings.factors:
        beta = factor * first["beta"]
        fits.append(stage(f"softmax, {factor:g} x beta", lambda beta=beta: work.softmax(beta)))
    by_trajectory = stage("trajectory", work.trajectory)
    bound = stage("bound", lambda: work.bound(clean, sigma))
    return {
        "cell": asdict(cell),
        "parameters": body.space.names,
        "width": body.space.width.tolist(),
        "transitions": len(dataset.transitions()),
        "before": first["before"],
        "softmax": {"fits": fits, "chosen": fits.index(chosen(fits)), "oracle": fits.index(oracle(fits))},
        "trajectory": by_trajectory,
        "bound": bound,
        "steps_per_core_second": stage("rate", work.rate),
    }


@dataclass
class _Work:
    """The computations of a cell's stages; each gives plain JSON values."""

    cell: Cell
    settings: Settings
    simulator: MujocoSimulator
    dataset: Dataset
    truth: Truth

    def softmax(self, beta: float | None) -> dict[str, Any]:
        result, counts = self._fit("softmax", replace(self.settings.softmax, beta=beta))
        last = result.history[-1]
        found = self._evaluate(result.distribution, result.initial)
        return {
            "automatic": beta is None,
            "beta": last["beta"],
            "effective": last["effective"],
            "score": score(self.simulator, self.dataset, result.distribution, self.cell.seed),
            **_distances(found, "estimate"),
            **counts,
            "before": {name: _distances(found, name) for name in ("initial", "uniform", "population")},
        }

    def trajectory(self) -> dict[str, Any]:
        result, counts = self._fit("trajectory", self.settings.trajectory)
        answers = {"population": result.distribution, "episodes": result.episodes or result.distribution}
        robots = _robots(result, self.truth)
        kept = ("converged", "bandwidth", "noise_degrees", "simulated_steps", "seconds")
        return {
            **{name: _distances(self._evaluate(d), "estimate") for name, d in answers.items()},
            **counts,
            "rounds": len(result.history),
            "history": result.history,
            "info": {k: result.info[k] for k in kept if k in result.info},
            "robots": robots,
            "residuals": self._residuals(np.array(robots["value"])),
        }

    def bound(self, clean: Dataset, sigma: Array) -> dict[str, Any]:
        found = information_bound(self.simulator, clean, self.truth, sigma)
        return {k: None if v is None else v.tolist() for k, v in vars(found).items()}

    def rate(self) -> float:
        """Simulated steps in a second of one core, the best of five, with all rows of a call at other parameters."""
        windows = self.dataset.transitions()[:256]
        xi = self.simulator.space.uniform(20, np.random.default_rng(self.cell.seed))
        rates = []
        for _ in range(5):
            steps, cpu = self.simulator.simulated_steps, time.process_time()
            self.simulator.losses(xi, windows, np.ones(self.simulator.states.ndiff))
            rates.append((self.simulator.simulated_steps - steps) / (time.process_time() - cpu))
        return max(rates)

    def _fit(self, method: Any, config: Any) -> tuple[FitResult, dict[str, float]]:
        begun, cpu = time.perf_counter(), time.process_time()
        result = fit(self.simulator, self.dataset, method=method, config=config, seed=self.cell.seed, quiet=True)
        counts = {
            "million_steps": result.info["simulated_steps"] / 1e6,
            "seconds": time.perf_counter() - begun,
            "cpu_seconds": time.process_time() - cpu,
        }
        return result, counts

    def _evaluate(self, d: ParameterDistribution, initial: ParameterDistribution | None = None) -> Evaluation:
        return evaluate(d, self.truth, initial=initial, samples=self.settings.samples)

    def _residuals(self, value: Array) -> dict[str, list[float]]:
        """Mean squared residual of every robot's recording, in increments, at its fitted and at its true parameters."""
        windows = self.dataset.transitions()
        scale = increment_scale(self.simulator.states, windows)
        xi = np.concatenate([value, self.truth.xi])
        losses = self.simulator.losses(xi, windows, scale) / len(scale)
        n = len(value)
        own = [[float(losses[r + k, windows.episode == r].mean()) for r in range(n)] for k in (0, n)]
        return {"fitted": own[0], "true": own[1]}


def _distances(found: Evaluation, row: str) -> dict[str, dict[str, float]]:
    return {
        "to_episodes": dict(vars(found.to_episodes[row])),
        "to_population": dict(vars(found.to_population[row])),
    }


def _robots(result: FitResult, truth: Truth) -> dict[str, Any]:
    """What fit.json says of each robot, one row a robot and one column a parameter, beside the truth."""
    tables = [r["parameters"] for r in result.info["robots"]]
    names = truth.space.names

    def matrix(key: str) -> list[list[Any]]:
        return [[table[name][key] for name in names] for table in tables]

    columns = {key: matrix(key) for key in ("value", "std", "cramer_rao", "known", "leans_on")}
    return {**columns, "true": truth.xi.tolist(), "modes": [r["modes"] for r in result.info["robots"]]}
