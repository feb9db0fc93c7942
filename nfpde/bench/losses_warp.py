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
from numpy.typing import NDArray

from nfpde.bench.code import code_of
from nfpde.bench.losses import SEED, _record
from nfpde.bench.partial import Partial
from nfpde.benchmarks import ROBOTS, Robot
from nfpde.dataset import Windows
from nfpde.errors import BadInput
from nfpde.sim import Device, MujocoSimulator, make_simulator, runs_on
from nfpde.sim.cores import usable_cores
from nfpde.storage import write_whole

Array = NDArray[np.float64]

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

APART, SOME = 0.01, 1e-3
"""How far a loss may be from double precision, relatively, but for such a part of them: rounding makes some 1e-5, and
2e-4 in one of a hundred; a foot that meets the ground one step later makes more."""

LONG, ENOUGH = 8.0, 0.5
"""Seconds after which a call is not repeated again, if it was three times; and that all calls together take at least:
in less, something else on the machine can slow down more than half of them."""

MEASURE = """
from nfpde.bench.losses_warp import measure
measure({robot!r}, {device!r}, {quick!r}, {path!r})
"""

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

    Robots are measured in turn; where the command is stopped, the same one goes on with the next.

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

    card = open_device(device).name  # refuses before anything is measured
    facts = {
        "command": f"nfpde bench losses --device {device}" + (" --quick" if quick else ""),
        "device": card,
        "seed": SEED,
        "vectors": VECTORS,
        "repeats": _repeats(quick),
        "seconds": ENOUGH,
        "cores": usable_cores(),
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "versions": {n: version(n) for n in ("nfpde", "mujoco", "mujoco_warp", "warp-lang", "numpy")},
        "code": code_of("bench/losses_warp.py", "benchmarks", "kernels"),
    }
    out.mkdir(parents=True, exist_ok=True)
    record = out / (f"losses_{device}" + ("_quick" if quick else ""))
    partial = Partial(record.with_suffix(".part.json"), facts)
    rows, starts = [], {}
    for robot in ROBOTS.values():
        found = partial.get(robot.name, lambda robot=robot: _in_its_own_process(robot, device, quick))
        rows += found["rows"]
        facts["device"] = found["device"]
        # without compiled kernels only once: they take as long for every robot
        cold = not quick and not starts
        starts[robot.name] = partial.get(
            f"start of {robot.name}", lambda robot=robot, cold=cold: _starts(robot, device, cold=cold)
        )
    facts["start_seconds"] = starts
    table = _table(rows, facts)
    print("\n" + table)
    write_whole(record.with_suffix(".json"), json.dumps({**facts, "rows": rows}, indent=1))
    write_whole(record.with_suffix(".md"), table)
    partial.finish()


def measure(robot: str, device: Device, quick: bool, path: str) -> None:
    """Measure all sizes of a robot, print them, and write them to a file as JSON."""
    known = ROBOTS[robot]
    windows = _record(known).transitions()
    sim: Any = make_simulator(known.model, known.space, device=device, check_influence=False)
    cpu = MujocoSimulator(known.model, known.space, check_influence=False)
    # what kernels take is not counted: they are loaded
    sim.losses(known.space.uniform(2, np.random.default_rng(SEED)), windows[np.arange(2)], np.ones(sim.states.ndiff))
    sim.release()
    free = sim.device.free_memory if sim.device.is_cuda else 0
    rows = []
    for size in TINY_SIZES if device == "warp-cpu" else QUICK_SIZES if quick else SIZES:
        rows.append(_row(known, sim, cpu, windows, size, free, _repeats(quick)))
        print(_line(rows[-1]), flush=True)
    write_whole(Path(path), json.dumps({"rows": rows, "device": runs_on(sim)}))


def _in_its_own_process(robot: Robot, device: Device, quick: bool) -> dict[str, Any]:
    """What `measure` writes; the most memory that was used is known of a whole process only."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rows.json"
        code = MEASURE.format(robot=robot.name, device=device, quick=quick, path=str(path))
        subprocess.run([sys.executable, "-c", code], check=True)
        return json.loads(path.read_text(encoding="utf-8"))


def _repeats(quick: bool) -> int:
    return 3 if quick else 7


def start(robot: str, device: Device) -> None:
    """From nothing to the first losses, as a fresh process does it."""
    known = ROBOTS[robot]
    windows = _record(known, episodes=1, steps=5).transitions()
    sim = make_simulator(known.model, known.space, device=device, check_influence=False)
    sim.losses(known.space.uniform(2, np.random.default_rng(SEED)), windows, np.ones(sim.states.ndiff))


def _starts(robot: Robot, device: Device, cold: bool) -> dict[str, float]:
    """Seconds to the first losses of a fresh process, with compiled kernels (warm), and without (cold)."""
    command = [sys.executable, "-c", START.format(robot=robot.name, device=device)]
    with tempfile.TemporaryDirectory() as folder:
        env = {**os.environ, "WARP_CACHE_PATH": folder} if cold else dict(os.environ)
        done = [subprocess.run(command, env=env, capture_output=True, text=True, check=True) for _ in range(2)]
    first, second = (float(d.stdout.split()[-1]) for d in done)
    return {"cold": first, "warm": second} if cold else {"warm": second}


def _row(
    robot: Robot, sim: Any, cpu: MujocoSimulator, windows: Windows, size: int, free: int, repeats: int
) -> dict[str, Any]:
    """Rates of one robot and size: losses, bare stepping with as many worlds at once, and the CPU.

    Args:
        robot: of the recordings.
        sim: on the device.
        cpu: the same in double precision.
        windows: recorded transitions; they are taken again where the size asks for more.
        size: pairs.
        free: memory of the device that was free before anything ran [bytes].
        repeats: calls timed.
    """
    from nfpde.sim.warp_bare import bare_stepping, used_bytes

    vectors = min(VECTORS, size)
    xi = robot.space.uniform(vectors, np.random.default_rng(SEED))
    scale = np.ones(sim.states.ndiff)
    chosen = windows[np.arange(size // vectors) % len(windows)]
    fewer = chosen[np.arange(min(len(chosen), max(1, CPU_PAIRS // vectors)))]
    seconds, found = _seconds(lambda: sim.losses(xi, chosen, scale), repeats)
    taken, used = sim.usage(), used_bytes(sim, free)
    sim.release()
    at_once = chosen[np.arange(max(1, taken.nworld // vectors)) % len(chosen)]
    bare, _ = _seconds(bare_stepping(sim, vectors, at_once, xi), repeats)
    nominal, _ = _seconds(bare_stepping(sim, vectors, at_once), repeats)
    on_cpu, expected = _seconds(lambda: cpu.losses(xi, fewer, scale), min(3, repeats))
    apart = _apart(found, expected, len(windows))
    rate, bare_rate = vectors * len(chosen) / seconds, vectors * len(at_once) / bare
    nominal_rate = vectors * len(at_once) / nominal
    return {
        "robot": robot.name,
        "pairs": vectors * len(chosen),
        "worlds_at_once": taken.nworld,
        "evaluations_per_second": rate,
        "bare_per_second": bare_rate,
        "share_of_bare": rate / bare_rate,
        "nominal_per_second": nominal_rate,
        "share_of_nominal": rate / nominal_rate,
        "cpu_per_second": vectors * len(fewer) / on_cpu,
        "predicted_bytes": taken.nbytes,
        "measured_bytes": used,
        "nconmax": taken.nconmax,
        "njmax": taken.njmax,
        "median_apart": float(np.median(apart)),
        "share_apart": float((apart > APART).mean()),
    }


def _apart(found: Array, expected: Array, nwindow: int) -> Array:
    """Relative differences from double precision, of losses all over a batch whose windows come again after `nwindow`.

    Args:
        found: (M, n)
        expected: of the first windows (M, k)
        nwindow: windows that are different.
    """
    window = np.arange(found.shape[1]) % nwindow
    known = window < expected.shape[1]
    return np.abs(found[:, known] / expected[:, window[known]] - 1)


def _seconds(way: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median wall time of a call, after one that is not counted, and what the last one gave.

    At least `repeats` calls and ENOUGH seconds, but of long calls three.
    """
    answer = way()
    found: list[float] = []
    while len(found) < 3 or (sum(found) < LONG and (len(found) < repeats or sum(found) < ENOUGH)):
        begin = time.perf_counter()
        answer = way()
        found.append(time.perf_counter() - begin)
    return median(found), answer


def _verdicts(rows: list[dict[str, Any]]) -> list[str]:
    """Whether the sizes that were measured are as fast as wanted, linear, and as large as predicted."""
    lines = [f"Wanted from {MANY} worlds at once on: a share of at least {SHARE}, time at most proportional to pairs,"]
    lines += [f"no more memory than predicted ({ROOM:g} times), and all but {SOME:.1%} of the losses, wherever in the"]
    lines += [f"batch they are, within {APART:.0%} of double precision.", ""]
    for name in dict.fromkeys(row["robot"] for row in rows):
        own = [row for row in rows if row["robot"] == name and row["worlds_at_once"] >= MANY]
        if not own:
            lines.append(f"- {name}: no size with {MANY} worlds at once was measured")
            continue
        share = min(row["share_of_bare"] for row in own)
        nominal = min(row["share_of_nominal"] for row in own)
        rates = [row["evaluations_per_second"] for row in own]
        # of a larger size, from the fastest smaller one: small ones leave a part of the GPU idle
        linear = min(rate / max(rates[: i + 1]) for i, rate in enumerate(rates))
        known = [row["measured_bytes"] / row["predicted_bytes"] for row in own if row["measured_bytes"] is not None]
        memory = f"memory used / predicted {max(known):.2f}" if known else "memory not measured"
        apart = max(row["share_apart"] for row in own)
        passed = share >= SHARE and linear >= SHARE and max(known, default=0.0) <= ROOM and apart <= SOME
        lines.append(
            f"- {name}: {'pass' if passed else 'FAIL'}; least share {share:.2f} ({nominal:.2f} of one "
            f"model), larger / smaller sizes' rate {linear:.2f}, {memory}, {apart:.2%} beyond {APART:.0%}"
        )
    return lines


def _line(row: dict[str, Any]) -> str:
    memory = [f"{b / 2**30:.2f}" if b is not None else "-" for b in (row["predicted_bytes"], row["measured_bytes"])]
    return (
        f"| {row['robot']} | {row['pairs']} | {row['worlds_at_once']} | {row['evaluations_per_second']:.0f} | "
        f"{row['bare_per_second']:.0f} | {row['share_of_bare']:.2f} | {row['nominal_per_second']:.0f} | "
        f"{row['share_of_nominal']:.2f} | {row['cpu_per_second']:.0f} | "
        f"{row['evaluations_per_second'] / row['cpu_per_second']:.1f} | {memory[0]} | {memory[1]} | "
        f"{row['median_apart']:.1e} |"
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
            f"{facts['repeats']} calls or more, {facts['seconds']:g} s at least (3 calls of long ones); {versions}; "
            f"{facts['machine']}, {facts['cores']} CPU core(s).",
            "",
            "One evaluation: set a recorded state and command, take one control step (4 or 5 physics steps), add up",
            "the loss; wall clock, from parameters in the host's memory to losses there. Bare: MuJoCo Warp's step",
            "alone, captured, of the same simulations: as many worlds at once, states, commands and parameters that",
            "are on the device already. One model: the same with the nominal parameters in all worlds, for which the",
            "solver iterates less often than for random ones. CPU: double precision on all cores. Apart: of the losses",
            "from those of the CPU, relatively.",
            "",
            "| robot | pairs | worlds at once | losses/s | bare/s | share | one model/s | share | CPU losses/s "
            "| times CPU | GiB predicted | GiB used | median apart |",
            "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
            *map(_line, rows),
            "",
            *_verdicts(rows),
            "",
            f"From nothing to the first losses, in a fresh process (cold: no kernel compiled): {begun}.",
            "",
        ]
    )
