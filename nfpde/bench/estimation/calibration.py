"""`nfpde bench estimation --calibration`: do the posteriors of single robots hold the truth as often as they say?"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from nfpde.bench.estimation.calibration_table import table
from nfpde.bench.estimation.cell import facts_of_device
from nfpde.bench.estimation.ranks import draw_ranks, rank_of
from nfpde.bench.estimation.stages import Budget, OutOfTime, Stages
from nfpde.benchmarks import record, robot
from nfpde.benchmarks.sensing import apart, differenced, filtered, with_noise
from nfpde.dataset import Dataset
from nfpde.errors import BadInput
from nfpde.estimation import TrajectoryConfig, fit
from nfpde.sim import Device, found_device, make_simulator
from nfpde.storage import write_whole

EPISODES = {"pendulum": 1, "payload": 1, "hopper": 4}
"""Episodes of the one robot: a Hopper falls after some 25 steps, and its noise has to be learned too. Of the payload's
robot only a sum of two masses is told: its posteriors are ridges that end at the bounds."""

DEFAULT_EPISODES = 1


def _as_it_is(dataset: Dataset) -> Dataset:
    return dataset


SENSING: dict[str, tuple[Callable[[Dataset], Dataset], Callable[[Dataset], Dataset]]] = {
    "": (_as_it_is, _as_it_is),
    "anew": (apart, _as_it_is),
    "differenced": (_as_it_is, differenced),
    "filtered": (_as_it_is, filtered),
}
"""How recordings are made: what is done to them before noise is put on them, and after."""


@dataclass(frozen=True)
class CalibrationSettings:
    """What is the same for all problems.

    Args:
        trajectory: settings of the fit.
        steps: longest episode, in control steps.
        noise: of the sensors, drawn log-uniformly between these shares of each channel's standard deviation.
        samples: of every posterior.
    """

    trajectory: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    steps: int = 100
    noise: tuple[float, float] = (0.001, 0.01)
    samples: int = 999


QUICK = CalibrationSettings(TrajectoryConfig(starts=2, steps=4, rounds=3), steps=30)
QUICK_PROBLEMS = 3


def calibrate(
    out: Path,
    *,
    robots: Sequence[str] = tuple(EPISODES),
    problems: int = 100,
    quick: bool = False,
    budget_minutes: float | None = None,
    device: Device = "cpu",
) -> bool:
    """Measure the problems that are not finished yet; write calibration.md, and JSON and a PNG for each robot.

    Each problem: a robot drawn uniformly from the box, which is the estimator's prior, recorded with sensor noise and
    fitted alone. Every robot has others beside it, see `SENSING`: a control, which tells errors of the inference from
    errors of what it takes the noise for, and velocities that no sensor measured.

    Args:
        out: folder of the table; the rest lies in `calibration/` in it.
        robots: names of benchmark robots.
        problems: of each robot; more that are finished already stay.
        quick: a few tiny problems of the pendulum instead, in `calibration_quick/`.
        budget_minutes: no further problem is begun after so long.
        device: where the fits are simulated; the table of another one than the CPU is `calibration_<device>`.

    Returns:
        Whether all problems are finished.

    Raises:
        BadInput: an unknown robot, no problem, or no such device.
    """
    device = found_device(device)
    if problems < 1:
        raise BadInput(f"problems must be at least 1, got {problems}")
    settings = QUICK if quick else CalibrationSettings()
    names, count = (["pendulum"], QUICK_PROBLEMS) if quick else (list(robots), problems)
    elsewhere = device != "cpu"
    folder = out / ("calibration" + (f"_{device}" if elsewhere else "") + ("_quick" if quick else ""))
    budget = Budget.of(budget_minutes)
    kinds = [(name, sensing) for sensing in SENSING for name in names]
    complete = all(_robot(name, sensing, folder, settings, count, budget, device) for name, sensing in kinds)
    options = (f" --device {device}" if elsewhere else "") + (" --quick" if quick else "")
    text = table(folder, f"nfpde bench estimation --calibration{options}")
    print(text)
    write_whole(out / f"{folder.name}.md", text)
    return complete


def _robot(
    name: str, sensing: str, folder: Path, settings: CalibrationSettings, count: int, budget: Budget, device: Device
) -> bool:
    """All problems of one kind that are not finished yet, and their picture; whether none is left."""
    parameters = robot(name).space.names
    same = json.loads(json.dumps({"episodes": EPISODES.get(name, DEFAULT_EPISODES), "settings": asdict(settings)}))
    facts = {"robot": name, "sensing": sensing, "problems": count, **same, **facts_of_device(robot(name), device)}
    stem = f"{name}_{sensing}" if sensing else name
    stages = _stages(folder, stem, facts, budget, same)
    before = max((int(i) + 1 for i in stages.done), default=0)
    if before > count:
        # finished problems cost hours: fewer asked for are no reason to drop them
        count = before
        stages = _stages(folder, stem, {**facts, "problems": count}, budget, same)
    if stages.finished() is not None:
        return True
    complete = True
    try:
        for i in range(count):
            stages(f"{i}", partial(problem, name, sensing, settings, i, device), same)
        stages.finish()
    except OutOfTime:
        complete = False
        print(f"{stages.path.stem}: {len(stages.done)} of {count} problems are finished: give the command again")
    if stages.done:
        ranks = [stage["result"]["rank"] for stage in stages.done.values()]
        title = f"{stages.path.stem}, {len(ranks)} problems"
        draw_ranks(ranks, settings.samples, parameters, title, stages.path.with_suffix(".png"))
    return complete


def _stages(folder: Path, stem: str, facts: dict[str, Any], budget: Budget, same: dict[str, Any]) -> Stages:
    """What is finished, but for problems of other settings: ranks of both have no place in one table."""
    stages = Stages(folder, stem, facts, budget)
    stages.done = {index: stage for index, stage in stages.done.items() if stage["settings"] == same}
    return stages


def problem(
    name: str, sensing: str, settings: CalibrationSettings, index: int, device: Device = "cpu"
) -> dict[str, Any]:
    """One problem: draw, record, fit; ranks of the true values, with errors in posterior standard deviations."""
    body = robot(name)
    rng = np.random.default_rng([index, 2])
    xi = body.space.uniform(1, rng)
    share = float(np.exp(rng.uniform(*np.log(settings.noise))))
    episodes = EPISODES.get(name, DEFAULT_EPISODES)
    clean = record(body, xi.repeat(episodes, 0), steps=settings.steps, rng=rng, labels=[name] * episodes)
    before, after = SENSING[sensing]
    dataset = after(with_noise(body.model, before(clean), share, index)[0])
    simulator = make_simulator(body.path, body.space, device=device)
    result = fit(simulator, dataset, method="trajectory", config=settings.trajectory, seed=index, quiet=True)
    posterior = result.episodes or result.distribution
    samples = posterior.sample(settings.samples, seed=index)
    (found,) = result.info["robots"]
    values = np.array([found["parameters"][p]["value"] for p in body.space.names])
    return {
        "rank": rank_of(xi[0], samples).tolist(),
        "true": xi[0].tolist(),
        "value": values.tolist(),
        "mean": samples.mean(0).tolist(),
        "std": samples.std(0).tolist(),
        "noise": share,
        "transitions": len(dataset.transitions()),
        "modes": found["modes"],
        "million_steps": result.info["simulated_steps"] / 1e6,
        "seconds": result.info["seconds"],
    }
