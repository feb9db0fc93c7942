"""How a robot moves without any fault: the scales that decide what is a small or a large fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.bench.gap.plant import Plant
from nfpde.bench.gap.record import Run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pilot:
    """Scales of a motion.

    Attributes:
        model: the robot without faults.
        position: spread of each degree of freedom (nv,) [rad or m].
        speed: the same of the velocities (nv,), and `top_speed` their 99 % quantile.
        top_speed: see above.
        torque: root mean square of what drives each degree of freedom (nv,), or what gravity and motion ask of it
            where nothing does [Nm or N].
        top_torque: 99 % quantile of its absolute value (nv,).
        inertia: mean diagonal of the mass matrix (nv,).
        command: spread of the commands (nu,).
    """

    model: mujoco.MjModel
    position: Array
    speed: Array
    top_speed: Array
    torque: Array
    top_torque: Array
    inertia: Array
    command: Array


def pilot_of(plant: Plant, runs: Sequence[Run]) -> Pilot:
    """Scales of recorded motions of a plant without faults."""
    model, data = plant.model, plant.data
    torques, inertias, offsets = [], [], []
    home = runs[0].clean_qpos[0]
    for run in runs:
        for qpos, qvel, ctrl in zip(run.clean_qpos[::3], run.clean_qvel[::3], run.ctrl[::3], strict=True):
            plant.put(qpos, qvel)
            data.ctrl[:] = ctrl
            mujoco.mj_forward(model, data)
            mass = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, mass)
            driven = data.qfrc_actuator.copy()
            passive = np.abs(np.diag(mass) * data.qacc) + np.abs(data.qfrc_bias)
            torques.append(np.where(driven != 0, driven, passive))
            inertias.append(np.diag(mass).copy())
            apart = np.zeros(model.nv)
            mujoco.mj_differentiatePos(model, apart, 1.0, home, qpos)
            offsets.append(apart)
    speeds = np.concatenate([run.clean_qvel for run in runs])
    torque = np.array(torques)
    return Pilot(
        model=model,
        position=np.std(offsets, 0),
        speed=speeds.std(0),
        top_speed=np.quantile(np.abs(speeds), 0.99, axis=0),
        torque=np.sqrt((torque**2).mean(0)),
        top_torque=np.quantile(np.abs(torque), 0.99, axis=0),
        inertia=np.mean(inertias, 0),
        command=np.concatenate([run.ctrl for run in runs]).std(0),
    )


def channels_of(spread: Array) -> Array:
    """Spreads (nv,) as they are, a channel that hardly moves counted as a hundredth of the widest."""
    return np.maximum(spread, 0.01 * spread.max())
