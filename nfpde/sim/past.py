"""The recorded motion before a window, between the rows of the recording."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.elements import is_axis

Array = NDArray[np.float64]


def speed_columns(model: mujoco.MjModel) -> NDArray[np.int32]:
    """For every column of positions the column of a state that holds its speed, -1 for those of quaternions (nq,)."""
    columns = np.full(model.nq, -1, np.int32)
    for joint in range(model.njnt):
        if is_axis(model, joint):
            columns[model.jnt_qposadr[joint]] = model.nq + model.jnt_dofadr[joint]
    return columns


def recorded_motion(model: mujoco.MjModel, rows: Array, nsub: int) -> Iterator[tuple[Array, Array]]:
    """Positions (R, nq) and velocities (R, nv) at every physics step before the last of the rows.

    Hinges and slides follow the cubic through the positions and speeds of neighbouring rows (Hermite), speeds go
    straight from row to row: a cubic's own acceleration would be made of the noise of positions. Quaternions stay as
    they were in the row before.

    Args:
        model: whose joints they are.
        rows: states of P + 1 recorded rows, the last one the window's start (R, P + 1, nq+nv).
        nsub: physics steps from row to row.
    """
    nq, columns, control_dt = model.nq, speed_columns(model), nsub * float(model.opt.timestep)
    q = np.flatnonzero(columns >= 0)
    speed = columns[q]
    for a, b in zip(rows.swapaxes(0, 1)[:-1], rows.swapaxes(0, 1)[1:], strict=True):
        rate_a, rate_b = control_dt * a[:, speed], control_dt * b[:, speed]
        for s in np.arange(nsub) / nsub:
            position = a[:, :nq].copy()
            ahead = b[:, q] - a[:, q]
            position[:, q] += s * (s * (3 - 2 * s) * ahead + (1 - s) * ((1 - s) * rate_a - s * rate_b))
            yield position, (1 - s) * a[:, nq:] + s * b[:, nq:]
