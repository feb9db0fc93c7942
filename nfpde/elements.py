"""Names of a model's elements: what `target` in a parameter or an effect may say, and the ids it stands for."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.errors import BadParameter, NfpdeError

KINDS = {
    "body": (mujoco.mjtObj.mjOBJ_BODY, "nbody"),
    "joint": (mujoco.mjtObj.mjOBJ_JOINT, "njnt"),
    "geom": (mujoco.mjtObj.mjOBJ_GEOM, "ngeom"),
    "site": (mujoco.mjtObj.mjOBJ_SITE, "nsite"),
    "tendon": (mujoco.mjtObj.mjOBJ_TENDON, "ntendon"),
    "actuator": (mujoco.mjtObj.mjOBJ_ACTUATOR, "nactuator"),
    "equality": (mujoco.mjtObj.mjOBJ_EQUALITY, "neq"),
}
"""Element kinds: MuJoCo's object type and the mjModel size that counts them."""

QPOS_WIDTHS = {0: 7, 1: 4, 2: 1, 3: 1}
"""Columns of qpos by the type of joint: free, ball, slide, hinge."""

DOF_WIDTHS = {0: 6, 1: 3, 2: 1, 3: 1}
"""Degrees of freedom by the type of joint."""


def element_names(model: mujoco.MjModel, kind: str) -> list[str]:
    """Name of every element of a kind, in id order.

    An actuator without a name goes by its joint's name (or `#<id>` when two would share it); anything else without
    a name by `#<id>`.
    """
    obj, size = KINDS[kind]
    names = [mujoco.mj_id2name(model, obj, i) or "" for i in range(getattr(model, size))]
    if kind == "actuator":
        joints = element_names(model, "joint")
        for i, name in enumerate(names):
            if not name and int(model.actuator_trntype[i]) in _JOINT_TRANSMISSIONS:
                joint = joints[int(model.actuator_trnid[i, 0])]
                names[i] = joint if joint not in names and not joint.startswith("#") else ""
    return [name or f"#{i}" for i, name in enumerate(names)]


_JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


def element_ids(
    model: mujoco.MjModel, kind: str, target: object, where: str, error: type[NfpdeError] = BadParameter
) -> NDArray[np.intp]:
    """Ids of the elements that `target` names: a name, an id, `#<id>`, a tuple of these, or "*" for all.

    Args:
        model: the model.
        kind: one of `KINDS`.
        target: what the user wrote.
        where: opens the message of an error.
        error: the class to raise.

    Raises:
        NfpdeError: (as `error`) an unknown name or id; the message lists what the model has.
    """
    names = element_names(model, kind)
    if isinstance(target, str) and target == "*":
        if not names:
            raise error(f"{where}: the model has no {kind}")
        return np.arange(len(names))
    wanted = target if isinstance(target, tuple) else (target,)
    ids = []
    for one in wanted:
        if isinstance(one, int | np.integer) and not isinstance(one, bool) and 0 <= one < len(names):
            ids.append(int(one))
        elif isinstance(one, str) and one in names:
            ids.append(names.index(one))
        elif isinstance(one, str) and one.startswith("#") and one[1:].isdigit() and int(one[1:]) < len(names):
            ids.append(int(one[1:]))
        else:
            shown = ", ".join(names[:40]) + (", ..." if len(names) > 40 else "") if names else f"no {kind} at all"
            raise error(f"{where}: the model has no {kind} {one!r}; it has: {shown}")
    if len(set(ids)) < len(ids):
        raise error(f"{where}: target {target!r} names one {kind} twice")
    return np.array(ids, dtype=np.intp)


def is_axis(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint id is that of a hinge or a slide, which have one degree of freedom."""
    return 0 <= joint < model.njnt and int(model.jnt_type[joint]) in (2, 3)


def is_jointed(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint id is that of a ball, a hinge or a slide: one whose bearing can hold it back."""
    return 0 <= joint < model.njnt and int(model.jnt_type[joint]) in (1, 2, 3)


def joint_dofs(model: mujoco.MjModel, joints: NDArray[np.intp]) -> NDArray[np.intp]:
    """Degrees of freedom (indices into qvel) of the given joints."""
    return _spread(model, joints, model.jnt_dofadr, DOF_WIDTHS)


def joint_qpos(model: mujoco.MjModel, joints: NDArray[np.intp]) -> NDArray[np.intp]:
    """Coordinates (indices into qpos) of the given joints."""
    return _spread(model, joints, model.jnt_qposadr, QPOS_WIDTHS)


def actuator_ctrls(model: mujoco.MjModel, actuators: NDArray[np.intp]) -> NDArray[np.intp]:
    """Commands (indices into ctrl) of the given actuators; most have one, a `pid` or `dcmotor` may have several."""
    parts = [int(model.actuator_ctrladr[i]) + np.arange(int(model.actuator_ctrlnum[i])) for i in actuators]
    return np.concatenate([np.zeros(0), *parts]).astype(np.intp)


def _spread(
    model: mujoco.MjModel, joints: NDArray[np.intp], start: NDArray[np.int32], widths: dict[int, int]
) -> NDArray[np.intp]:
    parts = [int(start[j]) + np.arange(widths[int(model.jnt_type[j])]) for j in joints]
    return np.concatenate([np.zeros(0), *parts]).astype(np.intp)


def listed(names: Sequence[str]) -> str:
    """Names, or other texts, in a sentence: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]
