"""Recording: episodes of a robot under a controller, with the noise of its sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.bench.gap.excite import Controller
from nfpde.bench.gap.plant import Moment, Plant
from nfpde.bench.gap.robots import Robot

Array = NDArray[np.float64]

_BLOWN_UP = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


@dataclass(frozen=True)
class Noise:
    """Errors of the sensors.

    Attributes:
        qpos: standard deviation of the positions, (nv,), in tangent space [rad or m].
        qvel: the same of the velocities, (nv,) [rad/s or m/s].
        grain: step of the encoders [rad or m]; 0 is none.
    """

    qpos: Array
    qvel: Array
    grain: float = 0.0


@dataclass(frozen=True)
class Run:
    """One recorded episode.

    Attributes:
        qpos: measured positions (R, nq).
        qvel: measured velocities (R, nv).
        ctrl: commands (R, nu); row r acts until row r + 1.
        clean_qpos: what the sensors would have shown without noise (R, nq).
        clean_qvel: the same (R, nv).
        dq: error of each measured position in tangent space (R, nv).
        dv: error of each measured velocity (R, nv).
        moments: moments of the robot, one every `stride` rows from row 0.
        stride: rows between moments.
        stable: whether the physics stayed finite; MuJoCo starts anew where it does not, and goes on.
    """

    qpos: Array
    qvel: Array
    ctrl: Array
    clean_qpos: Array
    clean_qvel: Array
    dq: Array
    dv: Array
    moments: Sequence[Moment]
    stride: int
    stable: bool


def episode(
    plant: Plant, robot: Robot, start: tuple[Array, Array], control: Controller, n: int, noise: Noise, seed: int
) -> Run:
    """Record n rows.

    Args:
        plant: the robot with its faults.
        robot: what its user knows of it.
        start: qpos (nq,) and qvel (nv,) in which the user lets it go; lifted where that is inside the ground.
        control: the command of each row.
        n: rows.
        noise: errors of the sensors.
        seed: seed of these errors.
    """
    rng, model, stride = np.random.default_rng(seed), plant.model, 20
    rows: dict[str, list[Array]] = {k: [] for k in ("qpos", "qvel", "ctrl", "clean_qpos", "clean_qvel", "dq", "dv")}
    moments = []
    begin(plant, robot, start, control(0, *start))
    for row in range(n):
        qpos, qvel = plant.reading()
        dq, dv = _errors(model, qpos, noise, rng)
        seen = qpos.copy()
        mujoco.mj_integratePos(model, seen, dq, 1.0)
        ctrl = control(row, seen, qvel + dv)
        if row == 0:  # the first command has held for long
            begin(plant, robot, start, ctrl)
        if row % stride == 0:
            moments.append(plant.save())
        values = (seen, qvel + dv, ctrl, qpos, qvel, dq, dv)
        for key, value in zip(rows, values, strict=True):
            rows[key].append(value)
        plant.advance(ctrl)
    arrays = {key: np.array(value) for key, value in rows.items()}
    bad = sum(int(plant.data.warning[int(kind)].number) for kind in _BLOWN_UP)
    return Run(**arrays, moments=moments, stride=stride, stable=bad == 0)


def begin(plant: Plant, robot: Robot, start: tuple[Array, Array], ctrl: Array) -> None:
    """Put the robot down, outside the ground."""
    qpos, qvel = start[0].copy(), start[1]
    plant.begin(qpos, qvel, ctrl)
    if robot.lift is not None and plant.data.ncon:
        depth = float(np.min(plant.data.contact.dist))
        if depth < 0:
            qpos[robot.lift] -= depth
            plant.begin(qpos, qvel, ctrl)


def start_of(robot: Robot, model: mujoco.MjModel, rng: np.random.Generator) -> tuple[Array, Array]:
    """A random start about the robot's home: qpos (nq,) and qvel (nv,)."""
    qpos = np.array(robot.home, dtype=np.float64)
    mujoco.mj_integratePos(model, qpos, rng.uniform(-1, 1, model.nv) * np.asarray(robot.start), 1.0)
    return qpos, rng.uniform(-1, 1, model.nv) * np.asarray(robot.speed)


def _errors(model: mujoco.MjModel, qpos: Array, noise: Noise, rng: np.random.Generator) -> tuple[Array, Array]:
    dq, dv = rng.normal(size=model.nv) * noise.qpos, rng.normal(size=model.nv) * noise.qvel
    if noise.grain:
        for joint in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
            at, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
            seen = qpos[at] + dq[dof]
            dq[dof] += noise.grain * np.round(seen / noise.grain) - seen
    return dq, dv
