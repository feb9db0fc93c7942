"""The step of an encoder, read off its readings."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.elements import is_axis

Array = NDArray[np.float64]

_SAME = 1e-9
"""Readings that differ by less than this share of their range are one: rounding."""

_LEAST_STEPS, _OFTEN = 8, 10
"""Steps between neighbouring readings from which a grain is told, at least; fewer will do where rows are so many times
as many: a robot at rest shows few readings, again and again."""

_PARTS, _WHOLE = 3, 1e-2
"""Parts of the shortest step that are tried for the grain, which may never occur alone; how near to a whole number of
them, in shortest steps, every step is."""


def encoder_grain(model: mujoco.MjModel, read: Array) -> Array:
    """Step of the readings of hinges, slides and velocities (2 nv,); zero where they are not multiples of one.

    Args:
        model: Whose joints they are.
        read: States as they were recorded (n, nq+nv).
    """
    grain = np.zeros(2 * model.nv)
    for dof, joint in enumerate(model.dof_jntid):
        if is_axis(model, int(joint)):
            grain[dof] = step_of(read[:, model.jnt_qposadr[joint]])
        grain[model.nv + dof] = step_of(read[:, model.nq + dof])
    return grain


def resting(model: mujoco.MjModel, rows: Windows) -> NDArray[np.bool_]:
    """Which hinges and slides read the same in most rows, by degree of freedom (nv,)."""
    found, read = np.zeros(model.nv, bool), rows.state[:, 0]
    for dof, joint in enumerate(model.dof_jntid):
        if is_axis(model, int(joint)):
            readings = np.sort(read[:, model.jnt_qposadr[joint]])
            same = np.diff(readings) <= _SAME * (readings[-1] - readings[0])
            found[dof] = _longest(same) > len(readings) / 2
    return found


def _longest(same: NDArray[np.bool_]) -> int:
    """Length of the longest run of equal values, from which neighbours are the same (n - 1,)."""
    ends = np.flatnonzero(~np.concatenate([[False], same, [False]]))
    return int(np.diff(ends).max())


def step_of(values: Array) -> float:
    """What values (n,) are multiples of, give or take a constant; zero if nothing."""
    readings = np.unique(values)
    steps = np.diff(readings)
    steps = steps[steps > _SAME * (readings[-1:] - readings[:1])]
    if not len(steps) or _LEAST_STEPS > len(steps) >= len(values) / _OFTEN:
        return 0.0
    shortest = float(steps.min())
    for part in range(1, _PARTS + 1):
        parts = steps * part / shortest
        if np.abs(parts - np.round(parts)).max() < _WHOLE * part:
            return shortest / part
    return 0.0
