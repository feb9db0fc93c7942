"""How large a fault is beside the noise: predictions over short windows, with it, without it, and with the true robot.

The gap is what the diagnosis means by it: predict from the measured state at the start of a window with the recorded
commands, whiten the error of every channel and step, take the mean square.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.bench.gap.plant import Plant
from nfpde.bench.gap.record import Run

Array = NDArray[np.float64]

HORIZON = 10
"""Control steps in a window."""

FAR = 25
"""Control steps of the farthest prediction whose noise floor is known."""

LEAST = 1e-5
"""Noise counts as at least this share of a channel's spread: below it lie solvers and rounding, not sensors."""

Start = Callable[[Plant, Run, int, int], None]
"""Puts a plant at a row of a run: (plant, run, row, number of the moment)."""


@dataclass(frozen=True)
class Windows:
    """Starts of windows: (number of the run, row, number of its moment)."""

    runs: Sequence[Run]
    starts: Sequence[tuple[int, int, int]]


def windows(runs: Sequence[Run], most: int, rng: np.random.Generator) -> Windows:
    """At most `most` windows that have `FAR` steps left, none before the third moment of its run."""
    starts = [
        (i, k * run.stride, k)
        for i, run in enumerate(runs)
        for k in range(2, len(run.moments))
        if k * run.stride + FAR < len(run.qpos)
    ]
    chosen = rng.permutation(len(starts))[:most]
    return Windows(runs, [starts[i] for i in sorted(chosen)])


def predict(plant: Plant, at: Windows, start: Start, *, clean: bool, steps: int = HORIZON) -> Array:
    """Prediction minus reading, (W, steps, 2 nv): positions in tangent space, then velocities.

    Args:
        plant: what predicts.
        at: the windows.
        start: how it is put at the start of a window.
        clean: compare with readings without noise.
        steps: control steps to predict, at most `FAR`.
    """
    nv = plant.model.nv
    errors = np.zeros((len(at.starts), steps, 2 * nv))
    for w, (i, row, k) in enumerate(at.starts):
        run = at.runs[i]
        seen_q, seen_v = (run.clean_qpos, run.clean_qvel) if clean else (run.qpos, run.qvel)
        start(plant, run, row, k)
        for step in range(steps):
            plant.advance(run.ctrl[row + step])
            qpos, qvel = plant.reading()
            mujoco.mj_differentiatePos(plant.model, errors[w, step, :nv], 1.0, seen_q[row + step + 1], qpos)
            errors[w, step, nv:] = qvel - seen_v[row + step + 1]
    return np.nan_to_num(np.clip(errors, -1e6, 1e6))


def from_reading(plant: Plant, run: Run, row: int, k: int) -> None:
    """Start from the measured state."""
    plant.put(run.qpos[row], run.qvel[row])


def from_clean(plant: Plant, run: Run, row: int, k: int) -> None:
    """Start from what the sensors would have shown without noise."""
    plant.put(run.clean_qpos[row], run.clean_qvel[row])


def from_moment(plant: Plant, run: Run, row: int, k: int) -> None:
    """Start from the true moment, disturbed by the error of the measurement there."""
    plant.load(run.moments[k], run.dq[row], run.dv[row])


def from_clean_moment(plant: Plant, run: Run, row: int, k: int) -> None:
    """Start from the true moment."""
    plant.load(run.moments[k])


def without(number: int) -> Start:
    """Start from the true moment, of all faults but one, with the reading for a state.

    What the other faults remember moves along: a rotor behind play stays where it was in the play.
    """

    def start(plant: Plant, run: Run, row: int, k: int) -> None:
        moment = run.moments[k].without(number)
        if any(fault.distorts for fault in plant.faults):
            plant.load(moment)
            return
        dq = np.zeros(plant.model.nv)
        mujoco.mj_differentiatePos(plant.model, dq, 1.0, moment.qpos, run.clean_qpos[row])
        plant.load(moment, dq, run.clean_qvel[row] - moment.qvel)

    return start


def floor_of(truth: Plant, at: Windows) -> tuple[Array, Array]:
    """Errors of the true robot from measured states (W, FAR, C), and their spread by step and channel (FAR, C)."""
    errors = predict(truth, at, from_moment, clean=False, steps=FAR)
    spread = np.sqrt((errors**2).mean(0))
    return errors, np.maximum(spread, LEAST * channel_spread(at))


def channel_spread(at: Windows) -> Array:
    """Spread of every channel over the windows' runs, (2 nv,): velocities, and positions in tangent space."""
    speeds = np.concatenate([run.clean_qvel for run in at.runs])
    length = np.mean([len(run.qpos) for run in at.runs])
    columns = [np.concatenate([run.clean_qpos[:, c] for run in at.runs]) for c in range(at.runs[0].qpos.shape[1])]
    positions = np.std(columns, 1)
    if len(positions) != speeds.shape[1]:  # a free body: its quaternion's columns have no tangent of their own
        positions = np.concatenate([positions[:3], np.full(3, positions[4:7].max() * 2), positions[7:]])
    spread = np.concatenate([positions, speeds.std(0)])
    return np.maximum(spread, 1e-9 + 1e-3 * spread.max() / np.sqrt(length))


def gap(errors: Array, scale: Array) -> float:
    """Mean square of errors (W, H, C) in units of `scale` (H, C)."""
    return float(((errors / scale) ** 2).mean())


def floor_by_step(floor: Array, before: Array, at: Windows) -> list[float]:
    """Share of the gap that the true robot leaves at each step, from the true and the nominal errors (W, H, C)."""
    scale = np.maximum(np.sqrt((before**2).mean(0)), LEAST * channel_spread(at))
    left, whole = (((errors / scale) ** 2).mean((0, 2)) for errors in (floor, before))
    return [share(float(part), float(all_)) for part, all_ in zip(left, whole, strict=True)]


def share(left: float, whole: float) -> float:
    """What is left of a gap; all of it where there was none, as with a true model and perfect sensors."""
    return left / whole if whole > 0 else 1.0


def size(errors: Array, scale: Array, answers: Sequence[Array] = ()) -> float:
    """Root mean square of errors (W, H, C) over the noise, after free constants have taken what they can.

    Args:
        errors: change of the predictions that a fault makes.
        scale: spread of the noise (H, C).
        answers: change that each free constant makes, (W, H, C) each.
    """
    whitened = (errors / scale).ravel()
    if answers:
        columns = np.stack([(answer / scale).ravel() for answer in answers], 1)
        columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        whitened = whitened - columns @ np.linalg.lstsq(columns, whitened, rcond=1e-9)[0]
    return float(np.sqrt((whitened**2).mean()))
