"""Typical magnitudes of a robot's motion, measured from recordings: what the size of an effect is counted in."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset

Array = NDArray[np.float64]

_ROWS = 2000
"""Rows that inverse dynamics looks at, at most."""


@dataclass(frozen=True, eq=False)
class DataScales:
    """Typical magnitudes, root mean squares over recordings; each positive but `middle`.

    control_dt: control step [s]
    middle: mean position of each degree of freedom, from qpos0 (nv,); of any sign
    position: distance from the mean position of each degree of freedom (nv,)
    speed: of each degree of freedom (nv,)
    acceleration: of each degree of freedom (nv,)
    force: generalized force behind the recorded motion (nv,); see `_force`
    ctrl: distance of each command from zero (nu,)
    ctrl_spread: distance of each command from its mean (nu,)
    actuator_force: of each actuator, before its gear (nu,)
    actuator_peak: its largest (nu,)
    length: size of the robot [m]
    """

    control_dt: float
    middle: Array
    position: Array
    speed: Array
    acceleration: Array
    force: Array
    ctrl: Array
    ctrl_spread: Array
    actuator_force: Array
    actuator_peak: Array
    length: float

    @classmethod
    def of(cls, model: mujoco.MjModel, dataset: Dataset) -> DataScales:
        """Measure them; mj_inverse gives the forces, with accelerations from differences of the velocities.

        Args:
            model: The nominal model.
            dataset: Recordings with the model's nq, nv and nu.
        """
        data = mujoco.MjData(model)
        positions, speeds, accelerations, forces, commands, drives = [], [], [], [], [], []
        driven, touching = [], []
        stride = max(1, sum(len(e) - 1 for e in dataset) // _ROWS)
        zero = model.qpos0
        for episode in dataset:
            commands.append(episode.ctrl)
            speeds.append(episode.qvel)
            for row in range(0, len(episode) - 1, stride):
                data.qpos[:], data.qvel[:] = episode.qpos[row], episode.qvel[row]
                data.ctrl[:] = episode.ctrl[row]
                data.qacc[:] = (episode.qvel[row + 1] - episode.qvel[row]) / dataset.control_dt
                accelerations.append(data.qacc.copy())
                mujoco.mj_inverse(model, data)
                forces.append(data.qfrc_inverse.copy())
                touching.append(data.ncon > 0)
                mujoco.mj_fwdActuation(model, data)
                drives.append(data.actuator_force.copy())
                driven.append(data.qfrc_actuator.copy())
                away = np.zeros(model.nv)
                mujoco.mj_differentiatePos(model, away, 1.0, zero, episode.qpos[row])
                positions.append(away)
        ctrl = np.concatenate(commands)
        return cls(
            control_dt=dataset.control_dt,
            middle=np.mean(positions, axis=0),
            position=_positive(np.std(positions, axis=0)),
            speed=_positive(_rms(np.concatenate(speeds))),
            acceleration=_positive(_rms(np.array(accelerations))),
            force=_positive(_force(np.array(forces), np.array(driven), np.array(touching))),
            ctrl=_positive(_rms(ctrl)),
            ctrl_spread=_positive(ctrl.std(0)),
            actuator_force=_positive(_rms(np.array(drives))),
            actuator_peak=_positive(np.abs(drives).max(0)),
            length=_size(model),
        )


def _force(inverse: Array, driven: Array, touching: NDArray[np.bool_]) -> Array:
    """Typical generalized force of every degree of freedom, (nv,), by inverse dynamics, where that can be believed.

    A contact is stiff: half a millimetre of error in a measured height makes it push with many times the robot's
    weight. Where recordings have contacts, rows without one count, if there are enough of them, and no joint that has a
    drive is moved by much more than its drive.

    Args:
        inverse: by inverse dynamics, (rows, nv).
        driven: of the drives, (rows, nv).
        touching: whether anything touches, (rows,).
    """
    if not touching.any():
        return _rms(inverse)
    free = np.flatnonzero(~touching)
    believed = _rms(inverse[free] if len(free) >= 0.1 * len(inverse) else inverse)
    drive = _rms(driven)
    return np.where(drive > 0, np.minimum(believed, drive), believed)


def _size(model: mujoco.MjModel) -> float:
    """Largest extent [m] along an axis of all geoms that move, at the reference position."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moving = np.flatnonzero(model.body_weldid[model.geom_bodyid] != 0)
    if not len(moving):
        return max(float(model.stat.extent), 1e-3)
    centre, reach = data.geom_xpos[moving], model.geom_rbound[moving, None]
    return max(float(((centre + reach).max(0) - (centre - reach).min(0)).max()), 1e-3)


def _rms(values: Array) -> Array:
    """Root mean square of every column, the largest fiftieth capped: impacts make accelerations of no typical size."""
    squares = values**2
    return np.sqrt(np.minimum(squares, np.quantile(squares, 0.98, axis=0)).mean(0))


def _positive(values: Array) -> Array:
    """What does not move counts a thousandth of what does; of nothing at all, one."""
    if not values.size:
        return values
    largest = float(values.max())
    return np.maximum(values, 1e-3 * largest) if largest > 0 else np.ones_like(values)
