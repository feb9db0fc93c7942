"""`nfpde bench estimation --calibration`: do the posteriors of single robots hold the truth as often as they say?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from nfpde.bench.estimation.ranks import WANTED, coverage, draw_ranks, histogram, rank_of
from nfpde.bench.estimation.sensing import with_noise
from nfpde.bench.estimation.stages import SCHEMA_VERSION, Budget, OutOfTime, Stages, provenance
from nfpde.benchmarks import record, robot
from nfpde.errors import BadInput
from nfpde.estimation import TrajectoryConfig, fit
from nfpde.sim import MujocoSimulator
from nfpde.storage import read_json, write_whole

EPISODES = {"pendulum": 1, "hopper": 4}
"""Episodes of the one robot: a Hopper falls after some 25 steps, and its noise has to be learned too."""

DEFAULT_EPISODES = 1


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
) -> bool:
    """Measure the problems that are not finished yet; write calibration.md, and JSON and a PNG for each robot.

    Each problem: a robot drawn uniformly from the box, which is the estimator's prior, recorded with sensor noise and
    fitted alone.

    Args:
        out: folder of the table; the rest lies in `calibration/` in it.
        robots: names of benchmark robots.
        problems: of each robot.
        quick: a few tiny problems of the pendulum instead, in `calibration_quick/`.
        budget_minutes: no further problem is begun after so long.

    Returns:
        Whether all problems are finished.

    Raises:
        BadInput: an unknown robot, or no problem.
    """
    if problems < 1:
        raise BadInput(f"problems must be at least 1, got {problems}")
    settings = QUICK if quick else CalibrationSettings()
    names, count = (["pendulum"], QUICK_PROBLEMS) if quick else (list(robots), problems)
    folder = out / ("calibration_quick" if quick else "calibration")
    budget = Budget.of(budget_minutes)
    complete = all(_robot(name, folder, settings, count, budget) for name in names)
    text = table(folder, "nfpde bench estimation --calibration" + (" --quick" if quick else ""))
    print(text)
    write_whole(out / f"{folder.name}.md", text)
    return complete


def _robot(name: str, folder: Path, settings: CalibrationSettings, count: int, budget: Budget) -> bool:
    """All problems of one robot that are not finished yet, and its picture; whether none is left."""
    parameters = robot(name).space.names
    facts = {"robot": name, "problems": count, "episodes": _episodes(name), "settings": asdict(settings)}
    stages = Stages(folder, name, facts, budget)
    if stages.finished() is not None:
        return True
    complete = True
    try:
        rows = [stages(f"{i}", partial(problem, name, settings, i)) for i in range(count)]
        stages.finish(summary(name, rows, settings.samples))
    except OutOfTime:
        complete = False
        rows = list(stages.done.values())
        print(f"{name}: {len(rows)} of {count} problems are finished: give the command again")
    if rows:
        ranks, title = [r["rank"] for r in rows], f"{name}, {len(rows)} problems"
        draw_ranks(ranks, settings.samples, parameters, title, folder / f"{name}.png")
    return complete


def problem(name: str, settings: CalibrationSettings, index: int) -> dict[str, Any]:
    """One problem: draw, record, fit; ranks of the true values, with errors in posterior standard deviations."""
    body = robot(name)
    rng = np.random.default_rng([index, 2])
    xi = body.space.uniform(1, rng)
    share = float(np.exp(rng.uniform(*np.log(settings.noise))))
    episodes = _episodes(name)
    clean = record(body, xi.repeat(episodes, 0), steps=settings.steps, rng=rng, labels=[name] * episodes)
    dataset, _ = with_noise(body.model, clean, share, index)
    simulator = MujocoSimulator(body.path, body.space)
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


def summary(name: str, rows: list[dict[str, Any]], samples: int) -> dict[str, Any]:
    """Coverage and histograms of finished problems."""
    ranks = [r["rank"] for r in rows]
    return {
        "robot": name,
        "parameters": robot(name).space.names,
        "problems": rows,
        "coverage": {share: coverage(ranks, samples, int(share) / 100) for share in WANTED},
        "histogram": histogram(ranks, samples),
    }


def table(folder: Path, command: str) -> str:
    """Coverage of every robot in the folder, finished or not, Markdown."""
    lines = []
    for path in sorted(folder.glob("*.json")):
        content = read_json(path, SCHEMA_VERSION)
        if path.name.endswith(".part.json"):
            if content["provenance"] != provenance() or not content["stages"]:
                continue
            facts = content["facts"]
            content |= summary(facts["robot"], list(content["stages"].values()), facts["settings"]["samples"])
        lines += _lines(content, folder.name)
    return "\n".join(
        [
            "# Calibration by simulation",
            "",
            "Every problem is a robot drawn uniformly from the box, which is the estimator's prior, recorded under "
            "random commands with white noise on every measured state (0.1 % to 1 % of each channel's standard "
            "deviation, drawn log-uniformly) and fitted alone by `trajectory`. A central region of its posterior must "
            "hold the true value as often as it says. After ±: one standard error, binomial for a parameter; for all "
            "together from the spread over problems, because the parameters of one problem are not independent.",
            "",
            *lines,
            f"`{command}`.",
            "",
        ]
    )


def _lines(content: dict[str, Any], folder: str) -> list[str]:
    half, most = (content["coverage"][share] for share in WANTED)
    rows = [
        f"| {name} | {a:.0%} ± {half['error']:.0%} | {b:.0%} ± {most['error']:.0%} |"
        for name, a, b in zip(content["parameters"], half["by_parameter"], most["by_parameter"], strict=True)
    ]
    verdicts = []
    for share, (low, high) in WANTED.items():
        found = content["coverage"][share]
        error = "" if found["pooled_error"] is None else f" ± {found['pooled_error']:.1%}"
        passed = low <= found["pooled"] <= high
        verdicts.append(
            f"{found['pooled']:.1%}{error} " + ("pass" if passed else f"FAIL: {low:.0%} to {high:.0%} wanted")
        )
    p, facts, done = content["provenance"], content["facts"], content["problems"]
    commit = (p["commit"] or "unknown")[:10] + (" with changes" if p["uncommitted"] else "")
    return [
        f"## {content['robot']}",
        "",
        "| parameter | central 50 % holds | central 90 % holds |",
        "|---|---|---|",
        *rows,
        f"| all | {verdicts[0]} | {verdicts[1]} |",
        "",
        f"![rank histograms]({folder}/{content['robot']}.png)",
        "",
        f"{len(done)} of {facts['problems']} problems, {facts['episodes']} episode(s) each, median "
        f"{np.median([r['transitions'] for r in done]):.0f} transitions and "
        f"{np.median([r['million_steps'] for r in done]):.2f} million simulated steps; code {commit}.",
        "",
    ]


def _episodes(name: str) -> int:
    return EPISODES.get(name, DEFAULT_EPISODES)
