"""One cell: one robot, population, noise and seed; softmax and trajectory fits of the same recordings."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from nfpde.bench.estimation.bending import bending
from nfpde.bench.estimation.bound import information_bound, unmoved
from nfpde.bench.estimation.draws import redrawn, yardsticks
from nfpde.bench.estimation.stages import code_of, results
from nfpde.bench.estimation.temperature import FACTORS, chosen, oracle, score
from nfpde.benchmarks import Robot, Target, collect, robot
from nfpde.benchmarks.sensing import with_noise
from nfpde.dataset import Dataset
from nfpde.distribution import ParameterDistribution
from nfpde.estimation import FitResult, NfpdeConfig, TrajectoryConfig, fit
from nfpde.evaluate import Evaluation, evaluate
from nfpde.losses import increment_scale
from nfpde.sim import Device, MujocoSimulator, Simulator, make_simulator, runs_on
from nfpde.truth import Truth

Array = NDArray[np.float64]
Stage = Callable[[str, Callable[[], Any], Any], Any]
"""Name, computation and settings of a part of the work; gives what it computed, now or in an earlier call."""

SOFTMAX, TRAJECTORY, YARDSTICKS = "softmax, ", "trajectory", "yardsticks"
BENDING = "bending"
STUCK = "without sliding"
OWN = f"{SOFTMAX}own beta"


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


def facts_of_device(body: Robot, device: Device) -> dict[str, str]:
    """What a file says of where its fits were simulated; nothing where that is the CPU, as in all files before."""
    if device == "cpu":
        return {}
    return {"device": runs_on(make_simulator(body.path, body.space, device=device, check_influence=False))}


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


def measure(cell: Cell, settings: Settings, stage: Stage, device: Device = "cpu") -> None:
    """Record, fit both ways on a device, measure; every fit is a stage."""
    work = _Work(cell, settings, device)
    data = {"episodes": settings.episodes, "steps": settings.steps}
    measured = data | {"samples": settings.samples}
    by_softmax = measured | asdict(settings.softmax)
    first = stage(OWN, lambda: work.softmax(None), by_softmax)
    for factor in settings.factors:
        beta = factor * first["beta"]
        stage(f"{SOFTMAX}{factor:g} x beta", lambda beta=beta: work.softmax(beta), by_softmax | {"beta": beta})
    stage(TRAJECTORY, work.trajectory, measured | asdict(settings.trajectory))
    stage("bound", work.bound, data)
    if cell.noise:
        stage(BENDING, work.bending, data)
    stage(YARDSTICKS, lambda: yardsticks(work.recorded[1], settings.samples), measured)
    if cell.noise == 0 and work.friction is not None:
        stage(STUCK, work.stuck, data | asdict(settings.trajectory))
    stage("rate", work.rate, data)


def assemble(content: dict[str, Any]) -> dict[str, Any]:
    """What the table is made from, of a file with the stages of `measure`."""
    found = results(content)
    fits = [found[name] for name in found if name.startswith(SOFTMAX)]
    facts = content["facts"]
    space = robot(facts["cell"]["robot"]).space
    return {
        "cell": facts["cell"],
        "settings": facts["settings"],
        "device": facts.get("device", "cpu: MuJoCo, double precision"),
        "parameters": space.names,
        "width": space.width.tolist(),
        "before": found[OWN]["before"],
        "softmax": {"fits": fits, "chosen": fits.index(chosen(fits)), "oracle": fits.index(oracle(fits))},
        "trajectory": found[TRAJECTORY],
        "bound": found["bound"],
        BENDING: found.get(BENDING),
        YARDSTICKS: found.get(YARDSTICKS),
        STUCK: found.get(STUCK),
        "steps_per_core_second": found["rate"],
        "code": {"softmax": code_of(content["stages"][OWN]), "trajectory": code_of(content["stages"][TRAJECTORY])},
        "versions": content["stages"][TRAJECTORY]["provenance"]["versions"],
        "machine": content["stages"][TRAJECTORY]["provenance"]["machine"],
    }


class _Work:
    """The computations of a cell's stages; each gives plain JSON values. Nothing is recorded before it is needed."""

    def __init__(self, cell: Cell, settings: Settings, device: Device) -> None:
        self.cell, self.settings = cell, settings
        self.device: Device = device
        self.body = robot(cell.robot)

    @property
    def friction(self) -> int | None:
        """Index of the floor's friction among the parameters, if it is one."""
        found = [i for i, name in enumerate(self.body.space.names) if name.startswith("geom_friction")]
        return found[0] if found else None

    @cached_property
    def recorded(self) -> tuple[Dataset, Truth]:
        """Recordings without noise, and the truth."""
        s = self.settings
        return collect(self.body, self.cell.target, episodes=s.episodes, steps=s.steps, seed=self.cell.seed)

    @cached_property
    def measured(self) -> tuple[Dataset, Array]:
        """Recordings with noise, and the noise's standard deviations."""
        return with_noise(self.body.model, self.recorded[0], self.cell.noise, self.cell.seed)

    @cached_property
    def simulator(self) -> MujocoSimulator:
        """Of the robot, in double precision: measures what was fitted."""
        return MujocoSimulator(self.body.path, self.body.space)

    @cached_property
    def fitting(self) -> Simulator:
        """Of the robot, on the device: what is fitted with."""
        if self.device == "cpu":
            return self.simulator
        return make_simulator(self.body.path, self.body.space, device=self.device)

    def softmax(self, beta: float | None) -> dict[str, Any]:
        result, counts = self._fit("softmax", replace(self.settings.softmax, beta=beta))
        last = result.history[-1]
        found = self._evaluate(result.distribution, result.initial)
        return {
            "automatic": beta is None,
            "beta": last["beta"],
            "effective": last["effective"],
            "score": score(self.simulator, self.measured[0], result.distribution, self.cell.seed),
            **_distances(found, "estimate"),
            "redrawn": redrawn(result.distribution, self.recorded[1], self.settings.samples),
            **counts,
            "before": {name: _distances(found, name) for name in ("initial", "uniform", "population")},
        }

    def trajectory(self) -> dict[str, Any]:
        result, counts = self._fit("trajectory", self.settings.trajectory)
        answers = {"population": result.distribution, "episodes": result.episodes or result.distribution}
        robots = _robots(result, self.recorded[1])
        elsewhere = ("config", "space", "simulator", "dataset", "robots", "versions")
        return {
            **{name: _distances(self._evaluate(d), "estimate") for name, d in answers.items()},
            "redrawn": redrawn(result.distribution, self.recorded[1], self.settings.samples),
            **counts,
            "rounds": len(result.history),
            "history": result.history,
            "info": {k: v for k, v in result.info.items() if k not in elsewhere},
            "robots": robots,
            "residuals": self._residuals(np.array(robots["value"])),
        }

    def bound(self) -> dict[str, Any]:
        found = information_bound(self.simulator, *self.recorded, self.measured[1])
        return {k: None if v is None else v.tolist() for k, v in vars(found).items()}

    def bending(self) -> dict[str, Any]:
        found = bending(self.simulator, *self.recorded, self.measured[1], self.cell.seed)
        return vars(found) | {"whole": found.whole.tolist()}

    def stuck(self) -> dict[str, Any] | None:
        """A fit of the transitions alone in which nothing slides: what they say of friction, and of all else."""
        if self.friction is None:
            return None
        dataset = unmoved(self.simulator, *self.recorded, self.friction)
        result = fit(
            self.fitting,
            dataset,
            method="trajectory",
            config=self.settings.trajectory,
            seed=self.cell.seed,
            quiet=True,
        )
        known, bounds = (
            [[p[key] for p in r["parameters"].values()] for r in result.info["robots"]]
            for key in ("known", "cramer_rao")
        )
        i = self.friction
        return {
            "transitions": [r["windows"] for r in result.info["robots"]],
            "known": [row[i] for row in known],
            "cramer_rao": [row[i] for row in bounds],
            "others_known": [float(np.median(np.delete(row, i))) for row in known],
        }

    def rate(self) -> float:
        """Simulated steps in a second of one core, the best of five, with all rows of a call at other parameters."""
        windows = self.measured[0].transitions()[:256]
        xi = self.simulator.space.uniform(20, np.random.default_rng(self.cell.seed))
        rates = []
        for _ in range(5):
            steps, cpu = self.simulator.simulated_steps, time.process_time()
            self.simulator.losses(xi, windows, np.ones(self.simulator.states.ndiff))
            rates.append((self.simulator.simulated_steps - steps) / (time.process_time() - cpu))
        return max(rates)

    def _fit(self, method: Any, config: Any) -> tuple[FitResult, dict[str, float]]:
        # the first optimiser of a process loads torch's compiler: seconds that are no fit's
        torch.optim.Adam([torch.zeros(1)])
        simulator, dataset = self.fitting, self.measured[0]
        begun, cpu = time.perf_counter(), time.process_time()
        result = fit(simulator, dataset, method=method, config=config, seed=self.cell.seed, quiet=True)
        counts = {
            "million_steps": result.info["simulated_steps"] / 1e6,
            "seconds": time.perf_counter() - begun,
            "cpu_seconds": time.process_time() - cpu,
        }
        return result, counts

    def _evaluate(self, d: ParameterDistribution, initial: ParameterDistribution | None = None) -> Evaluation:
        return evaluate(d, self.recorded[1], initial=initial, samples=self.settings.samples)

    def _residuals(self, value: Array) -> dict[str, list[float]]:
        """Mean squared residual of every robot's recording, in increments, at its fitted and at its true parameters."""
        windows = self.measured[0].transitions()
        scale = increment_scale(self.simulator.states, windows)
        xi = np.concatenate([value, self.recorded[1].xi])
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
