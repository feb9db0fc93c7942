"""`nfpde bench losses`: prediction losses per CPU-second, beside MuJoCo's own C loop.

One evaluation sets a state and a command, takes one control step (4 or 5 physics steps), and reads the state. All ways
of doing it run in turn, on one thread, and are timed in CPU time: other work on the machine slows them alike.
"""

from __future__ import annotations

import gc
import json
import platform
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

import gymnasium
import mujoco
import mujoco.rollout
import numpy as np
from gymnasium.envs.mujoco.mujoco_env import MujocoEnv
from numpy.typing import NDArray

from nfpde.benchmarks import ROBOTS, Robot
from nfpde.dataset import Dataset, Episode
from nfpde.sim import MujocoSimulator
from nfpde.sim.quiet import quiet_mujoco
from nfpde.storage import write_whole

Array = NDArray[np.float64]
Way = Callable[[], int]
"""Does some evaluations and says how many."""

C_LOOP, ROWS, NOMINAL = "mujoco.rollout (C loop)", "losses, own parameters per row", "losses, nominal parameters"
PYTHON, GYM = "Python loop of mj_step", "Gymnasium set_state and step"
SEED = 0
VECTORS = 20
"""Parameter vectors of one call."""
BATCH = 6
"""The slow ways do one of so many evaluations."""


def run(quick: bool, out: Path) -> None:
    """Measure, print a table and write it to losses.md and losses.json.

    Args:
        quick: fewer repeats.
        out: folder for the tables.
    """
    repeats = 4 if quick else 16
    facts = {
        "command": "nfpde bench losses" + (" --quick" if quick else ""),
        "seed": SEED,
        "vectors": VECTORS,
        "repeats": repeats,
        "versions": {name: version(name) for name in ("nfpde", "mujoco", "gymnasium", "numpy")},
        "machine": f"{platform.machine()}, Python {platform.python_version()}, one thread",
    }
    rows = []
    for robot in ROBOTS.values():
        seconds = _measure(_ways(robot, _record(robot)), repeats)
        best, middle = ({k: f(v) for k, v in seconds.items()} for f in (min, median))
        rows += [
            {
                "robot": robot.name,
                "way": way,
                "evaluations_per_second": 1 / best[way],
                "median_per_second": 1 / middle[way],
                "ratio": best[C_LOOP] / best[way],
                "median_ratio": median(c / s for c, s in zip(seconds[C_LOOP], seconds[way], strict=True)),
            }
            for way in seconds
        ]
        print(*(_line(row) for row in rows[-len(seconds) :]), sep="\n", flush=True)
    table = _table(rows, facts)
    print("\n" + table)
    out.mkdir(parents=True, exist_ok=True)
    record = out / ("losses_quick" if quick else "losses")
    write_whole(record.with_suffix(".json"), json.dumps({**facts, "rows": rows}, indent=1))
    write_whole(record.with_suffix(".md"), table)


def _environment(robot: Robot) -> MujocoEnv:
    """Gymnasium's environment on the model of this package: the same solver for every way."""
    with quiet_mujoco():
        env = gymnasium.make(robot.env_id).unwrapped
    if not isinstance(env, MujocoEnv):
        raise TypeError(f"{robot.env_id} is no MuJoCo environment")
    env.model.opt.solver, env.model.opt.disableflags = robot.model.opt.solver, robot.model.opt.disableflags
    return env


def _record(robot: Robot, episodes: int = 10, steps: int = 100) -> Dataset:
    """Random commands to the nominal robot until it falls."""
    rng = np.random.default_rng(SEED)
    env = _environment(robot)
    limits = env.model.actuator_ctrlrange
    recordings = []
    for e in range(episodes):
        env.reset(seed=SEED + e)
        states, commands, ended = [np.concatenate([env.data.qpos, env.data.qvel])], [], False
        while not ended and len(commands) < steps:
            commands.append(rng.uniform(limits[:, 0], limits[:, 1]))
            ended = bool(env.step(commands[-1])[2])
            states.append(np.concatenate([env.data.qpos, env.data.qvel]))
        commands.append(commands[-1])
        rows, nq = np.array(states), env.model.nq
        recordings.append(
            Episode(f"{e}", env.dt * np.arange(len(rows)), rows[:, :nq], rows[:, nq:], np.array(commands))
        )
    env.close()
    return Dataset(recordings)


def _ways(robot: Robot, data: Dataset) -> dict[str, Way]:
    model, windows = robot.model, data.transitions()
    sim = MujocoSimulator(model, robot.space, nthread=1, check_influence=False)
    xi = robot.space.uniform(VECTORS, np.random.default_rng(SEED))
    # bounds lie symmetrically around the nominal values
    nominal = np.tile((robot.space.low + robot.space.high) / 2, (VECTORS, 1))
    scale = np.ones(sim.states.ndiff)
    nsub = sim.substeps(data.control_dt)

    def losses(vectors: Array) -> Way:
        return lambda: sim.losses(vectors, windows, scale).size

    scratch = mujoco.MjData(model)
    roller = mujoco.rollout.Rollout(nthread=1)
    trajectories = [
        (
            np.tile(np.concatenate([[0.0], e.qpos[0], e.qvel[0]]), (VECTORS, 1)),
            np.tile(e.ctrl[:-1].repeat(nsub, axis=0), (VECTORS, 1, 1)),
        )
        for e in data
    ]

    def c_loop() -> int:
        for start, ctrl in trajectories:
            roller.rollout(model, scratch, start, ctrl)
        return VECTORS * len(windows)

    some = range(0, len(windows), BATCH)

    def python_loop() -> int:
        for n in some:
            mujoco.mj_resetData(model, scratch)
            scratch.qpos, scratch.qvel = windows.start[n, : model.nq], windows.start[n, model.nq :]
            scratch.ctrl = windows.ctrl[n, 0]
            for _ in range(nsub):
                mujoco.mj_step(model, scratch)
            np.concatenate([scratch.qpos, scratch.qvel])
        return len(some)

    env = _environment(robot)
    env.reset(seed=SEED)

    def gym() -> int:
        for n in some:
            env.set_state(windows.start[n, : model.nq], windows.start[n, model.nq :])
            env.step(windows.ctrl[n, 0])
        return len(some)

    return {C_LOOP: c_loop, ROWS: losses(xi), NOMINAL: losses(nominal), PYTHON: python_loop, GYM: gym}


def _measure(ways: dict[str, Way], repeats: int) -> dict[str, list[float]]:
    """CPU-seconds per evaluation of every way, one of each in every round, in changing order."""
    for way in ways.values():
        way()
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    order = list(ways)
    rng = np.random.default_rng(SEED)
    gc.disable()
    for _ in range(repeats):
        rng.shuffle(order)
        for name in order:
            start = time.process_time()
            count = ways[name]()
            seconds[name].append((time.process_time() - start) / count)
    gc.enable()
    return seconds


def _line(row: dict[str, Any]) -> str:
    rates = f"{row['evaluations_per_second']:.0f} | {row['median_per_second']:.0f}"
    return f"| {row['robot']} | {row['way']} | {rates} | {row['ratio']:.3f} | {row['median_ratio']:.3f} |"


def _table(rows: list[dict[str, Any]], facts: dict[str, Any]) -> str:
    versions = ", ".join(f"{k} {v}" for k, v in facts["versions"].items())
    return "\n".join(
        [
            "# Prediction losses per CPU-second",
            "",
            f"`{facts['command']}`, seed {facts['seed']}, {facts['vectors']} parameter vectors, {facts['repeats']} "
            f"rounds; {versions}; {facts['machine']}.",
            "",
            "One evaluation: set a recorded state and command, take one control step (4 or 5 physics steps), read the",
            "state. All ways run in one process in turn, on one thread, in CPU time. Ratios are to the C loop, which",
            "replays the same recordings as long rollouts without setting any state or model: above 1 is faster.",
            "Own parameters change the motion, and with it the work of the contact solver; nominal ones do not.",
            "",
            "| robot | way | evaluations/s (best) | (median) | ratio of best | median ratio of a round |",
            "|---|---|---|---|---|---|",
            *map(_line, rows),
            "",
        ]
    )
