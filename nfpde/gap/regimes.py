"""What each joint does in a window: how it moves, whether its drive saturates, what it touches, how late it is."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.elements import actuator_ctrls, element_names, joint_dofs
from nfpde.sim.quiet import quiet_mujoco

_REST = 0.05
"""A joint rests where its speed stays below this share of its highest."""

_AT_LIMIT = 1e-6
"""A command or force counts as at its limit within this share of its range: recordings are rounded."""


@dataclass(frozen=True, eq=False)
class Question:
    """One way to sort windows.

    name: what is asked
    answers: the regimes
    of: index of the answer for every window and joint (N, joints)
    """

    name: str
    answers: tuple[str, ...]
    of: NDArray[np.intp]


def questions(model: mujoco.MjModel, windows: Windows) -> list[Question]:
    """Sort windows by motion, and by command, contact and time where that sorts them at all.

    Motion: the joint hardly moves, turns round, or moves below or above its typical speed. Command: at some step a
    drive of the joint is at the end of its command or force range. Contact: what the joint carries touches something
    else all the time, some of the time, or never. Time: which half of the recording.
    """
    touching, saturated = _poses(model, windows)
    often = touching.mean(1)
    contact = np.select([often >= 1.0, often > 0.0], [0, 1], 2)
    found = [
        Question("motion", ("rest", "reversal", "slow", "fast"), _motion(model, windows)),
        Question("command", ("saturated", "within limits"), np.where(saturated, 0, 1)),
        Question("contact", ("in contact", "contact changes", "in flight"), contact),
        Question("time", ("early", "late"), _time(windows, touching.shape[2])),
    ]
    return [found[0], *(q for q in found[1:] if len(np.unique(q.of)) > 1)]


def _motion(model: mujoco.MjModel, windows: Windows) -> NDArray[np.intp]:
    speed = windows.state[:, :, model.nq :]
    out = np.empty((len(windows), model.njnt), dtype=np.intp)
    for j in range(model.njnt):
        v = speed[:, :, joint_dofs(model, np.array([j]))]
        size = _size(model, j, v)
        rest = size.max(1) <= _REST * size.max()
        turns = ((v.min(1) < 0) & (v.max(1) > 0)).any(1)
        slow = size.mean(1) < np.sqrt((size**2).mean())
        out[:, j] = np.select([rest, turns, slow], [0, 1, 2], 3)
    return out


def _size(model: mujoco.MjModel, joint: int, speed: NDArray[np.float64]) -> NDArray[np.float64]:
    """How fast a joint moves (N, H + 1), of its speeds (N, H + 1, dofs).

    Of a free joint metres and radians have no sum: each counts in the largest there is.
    """
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return np.linalg.norm(speed, axis=2)
    kinds = [np.linalg.norm(part, axis=2) for part in np.split(speed, [3], axis=2)]
    return np.linalg.norm([kind / max(float(kind.max(initial=0.0)), 1e-300) for kind in kinds], axis=0)


def _time(windows: Windows, joints: int) -> NDArray[np.intp]:
    """Whether a window lies in the later half of what is used of its episode."""
    late = np.zeros(len(windows), dtype=np.intp)
    for episode in np.unique(windows.episode):
        mine = windows.episode == episode
        row = windows.row[mine]
        late[mine] = row > 0.5 * (row.min() + row.max())
    return np.repeat(late[:, None], joints, axis=1)


def _poses(model: mujoco.MjModel, windows: Windows) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether what a joint carries touches something else, (N, H + 1, joints); whether it saturates, (N, joints)."""
    count, nq = windows.horizon + 1, model.nq
    touching = np.zeros((len(windows), count, model.njnt), dtype=bool)
    saturated = np.zeros((len(windows), model.njnt), dtype=bool)
    data, carried, drives = mujoco.MjData(model), _carried(model), _drives(model)
    with quiet_mujoco():
        for n in range(len(windows)):
            for h in range(count):
                data.qpos[:], data.qvel[:] = windows.state[n, h, :nq], windows.state[n, h, nq:]
                data.ctrl[:] = windows.ctrl[n, min(h, count - 2)]
                mujoco.mj_fwdPosition(model, data)
                acting = np.flatnonzero(data.contact.efc_address >= 0)
                one, other = (_touched(model, data, carried, acting, side) for side in (0, 1))
                touching[n, h] = (one ^ other).any(1)
                if h < count - 1:
                    mujoco.mj_fwdVelocity(model, data)
                    mujoco.mj_fwdActuation(model, data)
                    saturated[n] |= _saturated(model, data, drives)
    return touching, saturated


def _touched(
    model: mujoco.MjModel, data: mujoco.MjData, carried: NDArray[np.bool_], contacts: NDArray[np.intp], side: int
) -> NDArray[np.bool_]:
    """Whether a joint carries what touches on one side of contacts (joints, contacts)."""
    geoms = data.contact.geom[contacts, side]
    flexible = geoms < 0  # no geom stands for what is flexible
    bodies = np.zeros(len(contacts), np.intp)
    bodies[~flexible] = model.geom_bodyid[geoms[~flexible]]
    found = carried[:, bodies]
    for i in np.flatnonzero(flexible):
        found[:, i] = carried[:, _flexed(model, data, int(contacts[i]), side)].any(1)
    return found


def _flexed(model: mujoco.MjModel, data: mujoco.MjData, contact: int, side: int) -> NDArray[np.intp]:
    """The bodies on which what is flexible hangs where it touches: those of a vertex, or of an element's vertices."""
    flex, element, vertex = (int(x[contact, side]) for x in (data.contact.flex, data.contact.elem, data.contact.vert))
    vertices = np.array([vertex])
    if vertex < 0:
        count = int(model.flex_dim[flex]) + 1
        vertices = model.flex_elem[int(model.flex_elemdataadr[flex]) + element * count :][:count]
    bodies = model.flex_vertbodyid[int(model.flex_vertadr[flex]) + vertices]
    return bodies[bodies >= 0]  # a vertex between nodes hangs on none of its own


def _carried(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Whether a body moves with a joint, (joints, bodies)."""
    out = np.zeros((model.njnt, model.nbody), dtype=bool)
    for body in range(1, model.nbody):
        out[:, body] = out[:, model.body_parentid[body]] | (model.jnt_bodyid == body)
    return out


def _drives(model: mujoco.MjModel) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether an actuator, and whether a command, drives a joint: (joints, actuators), (joints, nu)."""
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    forces = on_joint & (model.actuator_trnid[:, 0] == np.arange(model.njnt)[:, None])
    commands = np.zeros((model.njnt, model.nu), dtype=bool)
    for joint, own in enumerate(forces):
        commands[joint, actuator_ctrls(model, np.flatnonzero(own))] = True
    return forces, commands


def _saturated(
    model: mujoco.MjModel, data: mujoco.MjData, drives: tuple[NDArray[np.bool_], NDArray[np.bool_]]
) -> NDArray[np.bool_]:
    """Joints with a drive whose force or command is at the end of its range, or that are given all they can take."""
    forces, commands = drives
    strong = _at_end(data.actuator_force, model.actuator_forcerange, model.actuator_forcelimited)
    wide = _at_end(data.ctrl, model.actuator_ctrlrange, model.actuator_ctrllimited)
    full = _at_end(data.qfrc_actuator[model.jnt_dofadr], model.jnt_actfrcrange, model.jnt_actfrclimited)
    return (forces & strong).any(1) | (commands & wide).any(1) | full


def _at_end(value: NDArray[np.float64], ends: NDArray[np.float64], limited: NDArray[np.uint8]) -> NDArray[np.bool_]:
    low, high = ends[:, 0], ends[:, 1]
    margin = _AT_LIMIT * (high - low)
    return limited.astype(bool) & ((value <= low + margin) | (value >= high - margin))


def joint_columns(model: mujoco.MjModel) -> tuple[list[str], list[NDArray[np.intp]]]:
    """Names of the joints and their degrees of freedom."""
    names = element_names(model, "joint")
    return names, [joint_dofs(model, np.array([j])) for j in range(len(names))]
