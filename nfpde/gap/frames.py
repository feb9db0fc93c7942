"""Conventions in which a free joint or a ball was recorded: order of its quaternion, frames of its velocities."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nfpde.dataset import Dataset
from nfpde.dataset.travel import SPAN
from nfpde.elements import element_names
from nfpde.errors import BadDataset
from nfpde.gap.readings import CURED

Array = NDArray[np.float64]

_ORDER = (
    "its quaternions look recorded as x, y, z, w, and MuJoCo's begin with w",
    "roll every quaternion by one column",
)
_TURNING = (
    "its angular velocity looks recorded in the world's frame, and MuJoCo's is in the body's",
    "multiply it by the transpose of the body's rotation matrix",
)
_MOVING = (
    "its linear velocity looks recorded in the body's frame, and MuJoCo's is in the world's",
    "multiply it by the body's rotation matrix",
)


@dataclass(frozen=True, eq=False)
class _Motion:
    """Motion from row to row, episode after episode (S, 3) each; attitudes from the body's to the world's frame.

    went, turned: change of place and of attitude, in the world's frame
    travel, rotation: what the velocities say, as they were recorded
    attitude: between the rows
    """

    went: Array
    turned: Array
    travel: Array
    rotation: Array
    attitude: Rotation

    @classmethod
    def of(cls, dataset: Dataset, q: int, v: int, *, free: bool, w_last: bool) -> _Motion:
        """Of a joint whose columns begin at q and v; its quaternions taken as x, y, z, w or as w, x, y, z."""
        at, turning = (q + 3, v + 3) if free else (q, v)
        parts = []
        for episode in dataset:
            quaternions = episode.qpos[:, at : at + 4]
            attitude = Rotation.from_quat(quaternions if w_last else np.roll(quaternions, -1, axis=1))
            local = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
            between = attitude[:-1] * Rotation.from_rotvec(0.5 * local)
            mean = 0.5 * (episode.qvel[1:] + episode.qvel[:-1]) * dataset.control_dt
            changes = np.diff(episode.qpos[:, q : q + 3], axis=0), between.apply(local)
            parts.append((*changes, mean[:, v : v + 3], mean[:, turning : turning + 3], between.as_quat()))
        went, turned, travel, rotation, attitudes = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(went, turned, travel, rotation, Rotation.from_quat(attitudes))


def check_frames(model: mujoco.MjModel, dataset: Dataset) -> None:
    """Refuse free joints and balls whose quaternions or velocities were recorded in another convention than MuJoCo's.

    A quaternion is w, x, y, z; a free joint's linear velocity is in the world's frame, the angular velocity of a free
    joint or a ball in the body's own. What velocities say must be the change of place and attitude; where another
    convention makes them so and this one does not, they were recorded in that one.

    Args:
        model: Says which columns belong to which joint.
        dataset: Recordings in the model's order.

    Raises:
        BadDataset: Which joint's, in which convention, and how to convert.
    """
    for joint, name in enumerate(element_names(model, "joint")):
        kind = int(model.jnt_type[joint])
        free = kind == int(mujoco.mjtJoint.mjJNT_FREE)
        if free or kind == int(mujoco.mjtJoint.mjJNT_BALL):
            columns = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
            both = [_Motion.of(dataset, *columns, free=free, w_last=last) for last in (False, True)]
            _check_turning(name, *both)
            if free:
                _check_moving(name, both[0])


def _check_turning(name: str, right: _Motion, rolled: _Motion) -> None:
    errors = {
        (last, world): _apart(m.rotation if world else m.attitude.apply(m.rotation), m.turned)
        for last, m in ((False, right), (True, rolled))
        for world in (False, True)
    }
    last, world = min(errors, key=lambda convention: errors[convention])
    if errors[last, world] < CURED * min(1.0, errors[False, False]):
        found = [*([_ORDER] if last else []), *([_TURNING] if world else [])]
        _refuse(name, found, errors[last, world], errors[False, False], "attitude")


def _check_moving(name: str, motion: _Motion) -> None:
    own, body = (_apart(t, motion.went) for t in (motion.travel, motion.attitude.apply(motion.travel)))
    if body < CURED * min(1.0, own):
        _refuse(name, [_MOVING], body, own, "place")


def _refuse(name: str, found: list[tuple[str, str]], error: float, own: float, of: str) -> None:
    raise BadDataset(
        f"{name}: {', and '.join(looks for looks, _ in found)} (the velocities miss {error:.2g} of the squared change "
        f"of {of} when that is undone, {own:.2g} as recorded). Convert them: {'; '.join(remedy for _, remedy in found)}"
    )


def _apart(told: Array, moved: Array) -> float:
    """Squared difference of motions, added up over spans, as a share of the motion; 1 where nothing moves."""
    starts = np.arange(0, len(moved), SPAN)
    told, moved = (np.add.reduceat(steps, starts, axis=0) for steps in (told, moved))
    size = float((moved**2).sum())
    return float(((told - moved) ** 2).sum()) / size if size > 0 else 1.0
