"""`nfpde bench losses --device cuda`: all pairs of parameters and windows on a GPU, beside bare stepping and the CPU.

One evaluation sets a state and a command, takes one control step, and adds up the whitened loss; parameters are the
rows' own. Times are wall clock, from the parameters in the host's memory to the losses there.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from nfpde.bench.losses import SEED, _record
from nfpde.benchmarks import ROBOTS, Robot
from nfpde.dataset import Windows
from nfpde.errors import BadInput
from nfpde.sim import Device, MujocoSimulator, make_simulator, runs_on

VECTORS = 100
"""Parameter vectors of one call; the windows make up the rest of the pairs."""

SIZES = (1_000, 10_000, 32_000, 100_000, 1_000_000, 4_000_000)
QUICK_SIZES = (1_000, 32_000)
TINY_SIZES = (200,)
"""Pairs of one call; tiny ones without a GPU, where only the code is tried."""

CPU_PAIRS = 20_000
"""Pairs of one call on the CPU, whose time is proportional to them."""

SHARE, MANY, ROOM = 0.9, 30_000, 1.2
"""What is wanted: see `_verdicts`."""

START = """
import time
begin = time.perf_counter()
import numpy as np
from nfpde.bench.losses_warp import start
start({robot!r}, {device!r})
print(time.perf_counter() - begin)
"""


def run(quick: bool, out: Path, device: Device) -> None:
    """Measure, print a table and write it to losses_<device>.md and .json.

    Args:
        quick: fewer sizes and repeats.
        out: folder for the tables.
        device: `cuda`, or `warp-cpu` to try the code.

    Raises:
        BadInput: another device, or no GPU.
    """
    if device not in ("cuda", "warp-cpu"):
        raise BadInput(f"device is {device!r}; this table is of cuda or warp-cpu")
    from nfpde.sim.warp_device import open_device

    open_device(device)  # refuses before anything is measured
    sizes = TINY_SIZES if device == "warp-cpu" else QUICK_SIZES if quick else SIZES
    repeats = 3 if quick else 7
    rows, starts, card = [], {}, ""
    for robot in ROBOTS.values():
        starts[robot.name] = _starts(robot, device, cold=not quick)
        windows = _record(robot).transitions()
        sim = make_simulator(robot.model, robot.space, device=device, check_influence=False)
        card = runs_on(sim)
        cpu = MujocoSimulator(robot.model, robot.space, check_influence=False)
        for size in sizes:
            rows.append(_row(robot, sim, cpu, windows, size, repeats))
            print(_line(rows[-1]), flush=True)
    facts = {
        "command": f"nfpde bench losses --device {device}" + (" --quick" if quick else ""),
        "device": card,
        "seed": SEED,
        "vectors": VECTORS,
        "repeats": repeats,
        "cores": len(os.sched_getaffinity(0)),
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "versions": {n: version(n) for n in ("nfpde", "mujoco", "mujoco_warp", "warp-lang", "numpy")},
        "start_seconds": starts,
    }
    table = _table(rows, facts)
    print("\n" + table)
    out.mkdir(parents=True, exist_ok=True)
    record = out / (f"losses_{device}" + ("_quick" if quick else ""))
    record.with_suffix(".json").write_text(json.dumps({**facts, "rows": rows}, indent=1), encoding="utf-8")
    record.with_suffix(".md").write_text(table, encoding="utf-8")


def start(robot: str, device: Device) -> None:
    """From nothing to the first losses, as a fresh process does it."""
    known = ROBOTS[robot]
    windows = _record(known, episodes=1, steps=5).transitions()
    sim = make_simulator(known.model, known.space, device=device, check_influence=False)
    sim.losses(known.space.uniform(2, np.random.default_rng(SEED)), windows, np.ones(sim.states.ndiff))


def _starts(robot: Robot, device: Device, cold: bool) -> dict[str, float]:
    """Seconds to the first losses of a fresh process, without (cold) and with (warm) compiled kernels."""
    command = [sys.executable, "-c", START.format(robot=robot.name, device=device)]
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        own_cache = {**os.environ, "WARP_CACHE_PATH": folder}
        for name, env in (("cold", own_cache), ("warm", own_cache)) if cold else (("warm", dict(os.environ)),):
            done = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
            found[name] = float(done.stdout.split()[-1])
    return found


def _row(robot: Robot, sim: Any, cpu: MujocoSimulator, windows: Windows, size: int, repeats: int) -> dict[str, Any]:
    """Rates of one robot and size: losses, bare stepping with as many worlds at once, and the CPU."""
    from nfpde.sim.warp_bare import bare_stepping, used_bytes

    vectors = min(VECTORS, size)
    xi = robot.space.uniform(vectors, np.random.default_rng(SEED))
    scale = np.ones(sim.states.ndiff)
    chosen = windows[np.arange(size // vectors) % len(windows)]
    fewer = chosen[np.arange(min(len(chosen), max(1, CPU_PAIRS // vectors)))]
    seconds = _seconds(lambda: sim.losses(xi, chosen, scale), repeats)
    taken = sim.usage()
    bare = _seconds(bare_stepping(sim, windows, taken.nworld), repeats)
    on_cpu = _seconds(lambda: cpu.losses(xi, fewer, scale), min(3, repeats))
    rate, bare_rate = vectors * len(chosen) / seconds, taken.nworld / bare
    return {
        "robot": robot.name,
        "pairs": vectors * len(chosen),
        "worlds_at_once": taken.nworld,
        "evaluations_per_second": rate,
        "bare_per_second": bare_rate,
        "share_of_bare": rate / bare_rate,
        "cpu_per_second": vectors * len(fewer) / on_cpu,
        "predicted_bytes": taken.nbytes,
        "measured_bytes": used_bytes(sim),
        "nconmax": taken.nconmax,
        "njmax": taken.njmax,
    }


def _seconds(way: Callable[[], object], repeats: int) -> float:
    """Median wall time of a call, after one that is not counted."""
    way()
    found = []
    for _ in range(repeats):
        begin = time.perf_counter()
        way()
        found.append(time.perf_counter() - begin)
    return median(found)


def _verdicts(rows: list[dict[str, Any]]) -> list[str]:
    """Whether the sizes that were measured are as fast as wanted, linear, and as large as predicted."""
    lines = [f"Wanted from {MANY} worlds at once on: a share of at least {SHARE}, time proportional to the pairs,"]
    lines += [f"and no more memory than predicted ({ROOM:g} times).", ""]
    for name in dict.fromkeys(row["robot"] for row in rows):
        own = [row for row in rows if row["robot"] == name and row["worlds_at_once"] >= MANY]
        if not own:
            lines.append(f"- {name}: no size with {MANY} worlds at once was measured")
            continue
        share = min(row["share_of_bare"] for row in own)
        rates = [row["evaluations_per_second"] for row in own]
        linear = min(rates) / max(rates)
        known = [row["measured_bytes"] / row["predicted_bytes"] for row in own if row["measured_bytes"] is not None]
        memory = f"memory used / predicted {max(known):.2f}" if known else "memory not measured"
        passed = share >= SHARE and linear >= SHARE and max(known, default=0.0) <= ROOM
        lines.append(
            f"- {name}: {'pass' if passed else 'FAIL'}; least share {share:.2f}, slowest / fastest {linear:.2f}, "
            f"{memory}"
        )
    return lines


def _line(row: dict[str, Any]) -> str:
    memory = [f"{b / 2**30:.2f}" if b is not None else "-" for b in (row["predicted_bytes"], row["measured_bytes"])]
    return (
        f"| {row['robot']} | {row['pairs']} | {row['worlds_at_once']} | {row['evaluations_per_second']:.0f} | "
        f"{row['bare_per_second']:.0f} | {row['share_of_bare']:.2f} | {row['cpu_per_second']:.0f} | "
        f"{row['evaluations_per_second'] / row['cpu_per_second']:.1f} | {memory[0]} | {memory[1]} |"
    )


def _table(rows: list[dict[str, Any]], facts: dict[str, Any]) -> str:
    versions = ", ".join(f"{k} {v}" for k, v in facts["versions"].items())
    begun = "; ".join(
        f"{robot} " + ", ".join(f"{kind} {s:.1f} s" for kind, s in times.items())
        for robot, times in facts["start_seconds"].items()
    )
    return "\n".join(
        [
            f"# Prediction losses on {facts['device']}",
            "",
            f"`{facts['command']}`, seed {facts['seed']}, {facts['vectors']} parameter vectors, median of "
            f"{facts['repeats']} calls; {versions}; {facts['machine']}, {facts['cores']} CPU core(s).",
            "",
            "One evaluation: set a recorded state and command, take one control step (4 or 5 physics steps), add up",
            "the loss; wall clock, from parameters in the host's memory to losses there. Bare: MuJoCo Warp's step",
            "alone, with as many worlds at once, one model, captured. CPU: double precision on all cores.",
            "",
            "| robot | pairs | worlds at once | losses/s | bare/s | share | CPU losses/s | times CPU | GiB predicted "
            "| GiB used |",
            "|---|---|---|---|---|---|---|---|---|---|",
            *map(_line, rows),
            "",
            *_verdicts(rows),
            "",
            f"From nothing to the first losses, in a fresh process (cold: no kernel compiled): {begun}.",
            "",
        ]
    )
