"""`nfpde bench devices`: fits and a diagnosis from end to end on a device, beside the CPU: the same answers, how fast.

The losses of a batch have a table of their own, `nfpde bench losses --device`, which this command makes as well.
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from nfpde.bench import losses_warp
from nfpde.bench.estimation.sensing import with_noise
from nfpde.bench.gap.draw import draw_system
from nfpde.bench.gap.store import write_public
from nfpde.bench.partial import Partial
from nfpde.benchmarks import collect, robot
from nfpde.dataset import Dataset, load_dataset
from nfpde.errors import BadInput
from nfpde.estimation import FitResult, Method, NfpdeConfig, TrajectoryConfig, fit
from nfpde.gap import diagnose_gap
from nfpde.ot import emd
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device, make_simulator, runs_on
from nfpde.storage import write_whole
from nfpde.truth import Truth

SEED = 0
ROBOT = "hopper"
NOISE = 0.001
"""Of the sensors, in standard deviations of each channel."""
SAMPLES = 2000
"""Of a fitted distribution, whose optimal transport to the true parameters is told, in widths of the bounds."""


@dataclass(frozen=True)
class Sizes:
    """How much is measured.

    episodes, steps: of the recordings that are fitted
    softmax, trajectory: settings of the fits
    systems: hidden faults to diagnose; none on warp-cpu, where one takes too long
    windows: of a diagnosis; None for its own choice
    """

    episodes: int = 10
    steps: int = 150
    softmax: NfpdeConfig = field(default_factory=NfpdeConfig)
    trajectory: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    systems: int = 3
    windows: int | None = None


QUICK = Sizes(
    episodes=3,
    steps=30,
    softmax=NfpdeConfig(iterations=3, samples=50, transitions=8, transforms=2, hidden=16),
    trajectory=TrajectoryConfig(starts=2, steps=4, rounds=3, population_rounds=1),
    systems=1,
    windows=40,
)


def run(quick: bool, out: Path, device: Device) -> None:
    """Measure, print the tables and write devices_<device>.md and .json, and those of the losses.

    Where the command is stopped, the same one goes on.

    Args:
        quick: tiny sizes.
        out: folder for the tables.
        device: `cuda`, or `warp-cpu` to try the code.

    Raises:
        BadInput: another device, or no GPU.
    """
    if device not in ("cuda", "warp-cpu"):
        raise BadInput(f"device is {device!r}; this table sets cuda or warp-cpu beside the cpu")
    sizes = QUICK if quick else Sizes()
    body = robot(ROBOT)
    simulators = [make_simulator(body.path, body.space, device=d, check_influence=False) for d in both(device)]
    facts = {
        "command": f"nfpde bench devices --device {device}" + (" --quick" if quick else ""),
        "devices": [runs_on(s) for s in simulators],
        "seed": SEED,
        "cores": len(os.sched_getaffinity(0)),
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "versions": {n: version(n) for n in ("nfpde", "mujoco", "mujoco_warp", "warp-lang", "torch", "numpy")},
    }
    out.mkdir(parents=True, exist_ok=True)
    record = out / (f"devices_{device}" + ("_quick" if quick else ""))
    partial = Partial(record.with_suffix(".part.json"), facts)
    partial.get("losses", lambda: losses_warp.run(quick, out, device))
    clean, truth = collect(body, "mixture", episodes=sizes.episodes, steps=sizes.steps, seed=SEED)
    data, _ = with_noise(body.model, clean, NOISE, SEED)
    parts: dict[str, Callable[[], dict[str, Any]]] = {
        "trajectory": lambda: _fit_row("trajectory", data, truth, sizes.trajectory, device),
        "softmax": lambda: _fit_row("softmax", data, truth, sizes.softmax, device),
    }
    for index in range(sizes.systems if device == "cuda" else 0):
        parts[f"diagnosis {index}"] = lambda index=index: _diagnosis_row(index, sizes.windows, device)
    rows = []
    for name, measure in parts.items():
        rows.append(partial.get(name, measure))
        print(_line(rows[-1]), flush=True)
    text = _table(rows, facts)
    print("\n" + text)
    write_whole(record.with_suffix(".json"), json.dumps({**facts, "rows": rows}, indent=1) + "\n")
    write_whole(record.with_suffix(".md"), text)
    partial.finish()


def both(device: Device) -> tuple[Device, Device]:
    """The CPU, and what is set beside it."""
    return "cpu", device


def _fit_row(
    method: Method, data: Dataset, truth: Truth, config: NfpdeConfig | TrajectoryConfig, device: Device
) -> dict[str, Any]:
    """The same fit on both devices: seconds, and how far apart the answers are."""
    body, results, seconds = robot(ROBOT), [], []
    for d in both(device):
        simulator = make_simulator(body.path, body.space, device=d)
        result, taken = _timed(
            lambda simulator=simulator: fit(simulator, data, method=method, config=config, seed=SEED, quiet=True)
        )
        results.append(result)
        seconds.append(taken)
    width = body.space.width
    distances = [emd(r.distribution.sample(SAMPLES, SEED) / width, truth.xi / width).cost for r in results]
    return {
        "what": f"fit by {method}, {ROBOT}, {len(data)} episodes",
        "seconds": seconds,
        "answers": [f"{d:.3g} from the truth" for d in distances],
        "apart": _apart(*results) if method == "trajectory" else f"{abs(distances[1] - distances[0]):.2g}",
    }


def _apart(here: FitResult, there: FitResult) -> str:
    """The largest difference of the robots' best values, in the standard deviations that the fits give them."""
    tables = [
        [[p[key] for p in r["parameters"].values()] for r in result.info["robots"]]
        for result in (here, there)
        for key in ("value", "std")
    ]
    value, std, other, other_std = map(np.array, tables)
    return f"{np.max(np.abs(value - other) / np.hypot(std, other_std)):.2g} standard deviations at most"


def _diagnosis_row(index: int, windows: int | None, device: Device) -> dict[str, Any]:
    """The same diagnosis of a hidden fault on both devices."""
    system = draw_system(SEED, index)
    reports, seconds = [], []
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        write_public(system.xml, system.free, system.robot, system.runs, home)
        params = home / "parameters.toml"
        space = ParameterSpace.from_toml(params) if params.is_file() else None
        data = load_dataset(home / "data.npz")
        for d in both(device):
            report, taken = _timed(
                lambda d=d: diagnose_gap(home / "model.xml", data, space, seed=SEED, windows=windows, device=d)
            )
            reports.append(report)
            seconds.append(taken)
    answers = [", ".join([r.verdict, *(f"{c.effect} {c.target}".strip() for c in r.effects)]) for r in reports]
    left = ", ".join(f"{r.gap.after_effects:.3g}" for r in reports)
    return {
        "what": f"diagnosis of hidden fault {index}",
        "seconds": seconds,
        "answers": answers,
        "apart": ("the same" if answers[0] == answers[1] else "ANOTHER ANSWER") + f"; gap left {left}",
    }


def _timed(way: Callable[[], Any]) -> tuple[Any, float]:
    begin = time.perf_counter()
    return way(), time.perf_counter() - begin


def _line(row: dict[str, Any]) -> str:
    (a, b), answers = row["seconds"], " | ".join(row["answers"])
    return f"| {row['what']} | {a:.1f} | {b:.1f} | {a / b:.2f} | {answers} | {row['apart']} |"


def _table(rows: list[dict[str, Any]], facts: dict[str, Any]) -> str:
    versions = ", ".join(f"{k} {v}" for k, v in facts["versions"].items())
    return "\n".join(
        [
            "# From end to end on two devices",
            "",
            f"`{facts['command']}`, seed {facts['seed']}; {versions}; {facts['machine']}, {facts['cores']} CPU "
            f"core(s). A: {facts['devices'][0]}. B: {facts['devices'][1]}.",
            "",
            f"Sensor noise {NOISE:.1%} in the fits. Seconds are wall clock, loading of kernels included. The path of a",
            "fit by softmax depends on the last bits (see docs/gpu.md): its answers differ as those of two seeds do.",
            "",
            "| what | A, s | B, s | A / B | answer of A | answer of B | apart |",
            "|---|---|---|---|---|---|---|",
            *map(_line, rows),
            "",
        ]
    )
