"""`nfpde bench devices`: fits and a diagnosis from end to end on a device, beside the CPU: the same answers, how fast.

The losses of a batch have a table of their own, `nfpde bench losses --device`, which this command makes as well.
"""

from __future__ import annotations

import json
import platform
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from nfpde.bench import losses_warp
from nfpde.bench.code import built_solver, code_of
from nfpde.bench.device_rows import RULES, diagnosis_row, softmax_row, trajectory_row
from nfpde.bench.gap.draw import draw_system
from nfpde.bench.gap.store import write_public
from nfpde.bench.partial import Partial
from nfpde.bench.rounded import RoundedSimulator
from nfpde.benchmarks import collect, robot
from nfpde.benchmarks.sensing import with_noise
from nfpde.dataset import Dataset, load_dataset
from nfpde.errors import BadInput
from nfpde.estimation import Method, NfpdeConfig, TrajectoryConfig, fit
from nfpde.gap import Fitted, diagnose_gap
from nfpde.ot import emd
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device, make_simulator, runs_on
from nfpde.sim.cores import usable_cores
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
    seeds: of the fits by softmax, two or more
    rounded: fits by trajectory on the CPU with predictions changed by rounding errors, that tell what is to be expected
    systems: hidden faults to diagnose, by index: an arm and a hopping leg; a quadruped's (0) takes most of an hour on
        two cores
    windows: of a diagnosis; None for its own choice
    """

    episodes: int = 10
    steps: int = 150
    softmax: NfpdeConfig = field(default_factory=NfpdeConfig)
    trajectory: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    seeds: int = 5
    rounded: int = 3
    systems: tuple[int, ...] = (2, 1)
    windows: int | None = None


QUICK = Sizes(
    episodes=3,
    steps=30,
    # as many iterations as a real fit: rounding is felt only after the flow has become narrow
    softmax=NfpdeConfig(samples=100, transitions=8, transforms=2, hidden=16),
    # to its end: two searches that were stopped on their way are apart as far as they still had to go
    trajectory=TrajectoryConfig(starts=2, population_rounds=1),
    # an arm without contacts: the cheapest of those whose cause so few windows tell
    systems=(2,),
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
        "cores": usable_cores(),
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "versions": {n: version(n) for n in ("nfpde", "mujoco", "mujoco_warp", "warp-lang", "torch", "numpy")},
        "code": code_of("bench/devices.py", "bench/gap/models", "benchmarks", "kernels"),
        "solver": built_solver(),
    }
    out.mkdir(parents=True, exist_ok=True)
    record = out / (f"devices_{device}" + ("_quick" if quick else ""))
    partial = Partial(record.with_suffix(".part.json"), facts)
    partial.get("losses", lambda: losses_warp.run(quick, out, device))
    clean, truth = collect(body, "mixture", episodes=sizes.episodes, steps=sizes.steps, seed=SEED)
    data, _ = with_noise(body.model, clean, NOISE, SEED)
    here, there = both(device)

    def of_fit(method: Method, config: NfpdeConfig | TrajectoryConfig, d: Device, seed: int) -> dict[str, Any]:
        return partial.get(f"{method}, {d}, seed {seed}", lambda: _fit(method, data, truth, config, d, seed))

    def trajectory() -> dict[str, Any]:
        first, second = (of_fit("trajectory", sizes.trajectory, d, SEED) for d in (here, there))
        rounded = [
            partial.get(
                f"trajectory, {here}, rounding {k}",
                lambda k=k: _fit("trajectory", data, truth, sizes.trajectory, here, SEED, rounding=k),
            )
            for k in range(sizes.rounded)
        ]
        return trajectory_row(f"fit by trajectory, {ROBOT}, {len(data)} episodes", first, second, rounded)

    def softmax() -> dict[str, Any]:
        fits = ([of_fit("softmax", sizes.softmax, d, seed) for seed in range(sizes.seeds)] for d in (here, there))
        return softmax_row(f"fit by softmax, {ROBOT}, {len(data)} episodes", *fits)

    def diagnosis(index: int) -> dict[str, Any]:
        found = (
            partial.get(f"diagnosis {index}, {d}", lambda d=d: _diagnosis(index, sizes.windows, d))
            for d in (here, there)
        )
        return diagnosis_row(f"diagnosis of hidden fault {index}", *found)

    rows, text = [], ""
    wanted = (trajectory, softmax, *(lambda index=index: diagnosis(index) for index in sizes.systems))
    for row in wanted:
        rows.append(row())
        print(_line(rows[-1]), flush=True)
        # a machine that is lent may be gone before the last row
        text = _table(rows, facts, len(wanted) - len(rows))
        write_whole(record.with_suffix(".json"), json.dumps({**facts, "rows": rows}, indent=1) + "\n")
        write_whole(record.with_suffix(".md"), text)
    print("\n" + text)
    partial.finish()


def both(device: Device) -> tuple[Device, Device]:
    """The CPU, and what is set beside it."""
    return "cpu", device


def _fit(
    method: Method,
    data: Dataset,
    truth: Truth,
    config: NfpdeConfig | TrajectoryConfig,
    device: Device,
    seed: int,
    rounding: int | None = None,
) -> dict[str, Any]:
    """A fit: seconds, distance to the truth, and the robots' values where it tells them; `rounding` is a seed."""
    body = robot(ROBOT)
    simulator = (
        make_simulator(body.path, body.space, device=device)
        if rounding is None
        else RoundedSimulator(body.path, body.space, rounding)
    )
    result, seconds = _timed(lambda: fit(simulator, data, method=method, config=config, seed=seed, quiet=True))
    width = body.space.width
    found: dict[str, Any] = {
        "seconds": seconds,
        "distance": emd(result.distribution.sample(SAMPLES, SEED) / width, truth.xi / width).cost,
    }
    if method == "trajectory":
        found["converged"] = result.info["converged"]
        for key in ("value", "std"):
            found[key] = [[p[key] for p in r["parameters"].values()] for r in result.info["robots"]]
    return found


def _diagnosis(index: int, windows: int | None, device: Device) -> dict[str, Any]:
    """The diagnosis of a hidden fault: seconds, verdict, causes and values."""
    system = draw_system(SEED, index, "one")
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        write_public(system.xml, system.free, system.robot, system.runs, home)
        params = home / "parameters.toml"
        space = ParameterSpace.from_toml(params) if params.is_file() else None
        data = load_dataset(home / "data.npz")
        report, seconds = _timed(
            lambda: diagnose_gap(home / "model.xml", data, space, seed=SEED, windows=windows, device=device)
        )
    return {
        "seconds": seconds,
        "verdict": report.verdict,
        "causes": {f"{c.effect} {c.target}".strip(): _fitted(c.parameters) for c in report.effects},
        "parameters": _fitted(report.base),
        "left": report.gap.after_effects,
    }


def _fitted(values: Mapping[str, Fitted]) -> dict[str, dict[str, float]]:
    return {name: {"value": v.value, "low": v.low, "high": v.high} for name, v in values.items()}


def _timed(way: Callable[[], Any]) -> tuple[Any, float]:
    begin = time.perf_counter()
    found = way()
    return found, time.perf_counter() - begin


def _line(row: dict[str, Any]) -> str:
    (a, b), answers = row["seconds"], " | ".join(row["answers"])
    verdict = "same" if row["same"] else "FAIL"
    return f"| {row['what']} | {a:.1f} | {b:.1f} | {a / b:.2f} | {answers} | {row['apart']} | {verdict} |"


def _table(rows: list[dict[str, Any]], facts: dict[str, Any], missing: int) -> str:
    versions = ", ".join(f"{k} {v}" for k, v in facts["versions"].items())
    return "\n".join(
        [
            "# From end to end on two devices",
            "",
            f"`{facts['command']}`, seed {facts['seed']}; {versions}; {facts['machine']}, {facts['cores']} CPU "
            f"core(s). A: {facts['devices'][0]}. B: {facts['devices'][1]}.",
            "",
            f"Sensor noise {NOISE:.1%} in the fits; distances by optimal transport, in widths of the bounds. Seconds",
            "are wall clock, loading of kernels included, of one fit or diagnosis. The path of a fit by softmax",
            "depends on the last bits (see docs/gpu.md): only several seeds can be compared. `same`, or else FAIL:",
            "",
            *(f"- {rule}." for rule in RULES),
            "",
            "| what | A, s | B, s | A / B | answer of A | answer of B | apart | verdict |",
            "|---|---|---|---|---|---|---|---|",
            *map(_line, rows),
            "",
            *(["The measurement was stopped here; the same command goes on.", ""] if missing else []),
        ]
    )
