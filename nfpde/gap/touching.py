"""Which joints carry nothing that touches anything, in any recorded state."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STATES = 2000
"""Recorded states looked at, at most, evenly over all."""


def free_dofs(model: mujoco.MjModel, states: Array) -> NDArray[np.intp]:
    """Degrees of freedom of joints that touch nothing with what they carry, ascending; none beside what is flexible.

    A foot on the ground presses against all joints above it, up to the root; an arm on top of the same robot feels it
    through the motion of its base alone, which is recorded.

    Args:
        model: The model.
        states: As they were recorded (n, nq + nv).
    """
    states = states[np.isfinite(states).all(1)]
    some = np.unique(np.linspace(0, len(states) - 1, min(STATES, len(states))).round().astype(int))
    data, pressed = mujoco.MjData(model), np.zeros(model.nv, dtype=bool)
    for state in states[some]:
        data.qpos[:] = state[: model.nq]
        mujoco.mj_fwdPosition(model, data)
        geoms = np.asarray(data.contact.geom)
        if (geoms < 0).any():  # it may hang on any body
            return np.zeros(0, np.intp)
        for body in np.unique(model.geom_bodyid[geoms]):
            pressed[_above(model, int(body))] = True
    return np.flatnonzero(~pressed)


def touches(model: mujoco.MjModel, states: Array) -> bool:
    """Whether anything touches anything in recorded states (n, nq + nv): the world, or another part of the robot."""
    return len(free_dofs(model, states)) < model.nv


def _above(model: mujoco.MjModel, body: int) -> list[int]:
    """Degrees of freedom that move a body."""
    while body and not model.body_dofnum[body]:
        body = int(model.body_parentid[body])
    dof, found = int(model.body_dofadr[body] + model.body_dofnum[body]) - 1 if body else -1, list[int]()
    while dof >= 0:
        found.append(dof)
        dof = int(model.dof_parentid[dof])
    return found
