"""Ways to write recordings down wrongly, undone: signs flipped, columns swapped, other units."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import mujoco
import numpy as np

from nfpde.dataset import Windows
from nfpde.elements import actuator_ctrls, element_names, is_axis, listed
from nfpde.gap.readings import DEGREES

Mistake = tuple[str, Callable[[Windows], Windows]]
"""What may look wrong, in words, and what undoes it."""

_PARTS = (("", True, True), (" in qpos and qvel", True, False), (" in the commands", False, True))
"""What may be flipped or swapped of a joint: how to say it, whether its states are, whether its commands are."""


@dataclass(frozen=True)
class Joint:
    """A hinge or slide.

    name: its name
    q, v: its columns in qpos and qvel
    turns: whether it is a hinge
    ctrls: commands of its actuators
    angles: those among them that are angles: of position servos
    """

    name: str
    q: int
    v: int
    turns: bool
    ctrls: tuple[int, ...]
    angles: tuple[int, ...]


def joints_of(model: mujoco.MjModel) -> list[Joint]:
    """The hinges and slides of a model."""
    on_joints = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    servos = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE) & (model.actuator_biasprm[:, 1] != 0)
    out = []
    for i, name in enumerate(element_names(model, "joint")):
        if is_axis(model, i):
            drives = on_joints & (model.actuator_trnid[:, 0] == i)
            ctrls, angles = (
                tuple(int(c) for c in actuator_ctrls(model, np.flatnonzero(some))) for some in (drives, drives & servos)
            )
            turns = model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE
            q, v = int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i])
            out.append(Joint(name, q, v, turns, ctrls, angles if turns else ()))
    return out


def flips_and_swaps(joints: list[Joint]) -> list[Mistake]:
    """Every joint's sign, and every two joints' columns: states, commands, or both."""
    flips: list[Mistake] = [
        (f"{j.name}'s sign looks flipped{of}", partial(_flipped, joint=j, states=states, commands=commands))
        for j in joints
        for of, states, commands in _parts(bool(j.ctrls))
    ]
    swaps: list[Mistake] = [
        (f"{a.name} and {b.name} look swapped{of}", partial(_swapped, a=a, b=b, states=states, commands=commands))
        for a, b in combinations(joints, 2)
        for of, states, commands in _parts(len(a.ctrls) == len(b.ctrls) > 0)
    ]
    return [*flips, *swaps]


def _parts(commanded: bool) -> tuple[tuple[str, bool, bool], ...]:
    """What may be flipped or swapped; where there are no commands to change, states alone."""
    return _PARTS if commanded else _PARTS[:1]


def in_other_units() -> list[Mistake]:
    """All commands too large or too small."""
    return [
        (
            f"the commands look {times}; convert them to what the model's actuators take",
            partial(with_commands, factor=x),
        )
        for times, x in (
            ("100 times too large, as in percent", 0.01),
            ("100 times too small, as shares of what should be percent", 100.0),
            ("1000 times too large", 0.001),
            ("1000 times too small", 1000.0),
            ("57.3 times too large, as in degrees", 1 / DEGREES),
            ("57.3 times too small, as in rad instead of degrees", DEGREES),
        )
    ]


def with_commands(windows: Windows, factor: float) -> Windows:
    """The windows with all commands multiplied by a number."""
    return replace(windows, ctrl=factor * windows.ctrl, history=factor * windows.history)


def in_degrees(joints: Sequence[Joint]) -> list[Mistake]:
    """These hinges recorded in degrees; once more with their commands, where these are angles."""
    looks = "looks" if len(joints) == 1 else "look"
    text = f"{listed([j.name for j in joints])} {looks} recorded in degrees; convert"
    out: list[Mistake] = [(f"{text} to rad", partial(_in_rad, joints=joints, commands=False))]
    if any(j.angles for j in joints):
        out.append((f"{text} qpos, qvel and commands to rad", partial(_in_rad, joints=joints, commands=True)))
    return out


def with_other_zeros(windows: Windows, changed: Windows, share: float = 1.0) -> Windows:
    """The windows with positions and commands shifted, and no more.

    Args:
        windows: As recorded.
        changed: The same after a change.
        share: Of what the change makes of them in the mean.
    """
    shift = share * (changed.state - windows.state).mean((0, 1))
    shift[windows.nq :] = 0.0
    push = share * (changed.ctrl - windows.ctrl).mean((0, 1))
    return replace(windows, state=windows.state + shift, ctrl=windows.ctrl + push, history=windows.history + push)


def _in_rad(windows: Windows, joints: Sequence[Joint], commands: bool) -> Windows:
    """Hinges' positions and speeds from degrees, and the angles among their commands or not."""
    scale_x, scale_u = np.ones(windows.state.shape[2]), np.ones(windows.nu)
    scale_x[[c for j in joints for c in (j.q, windows.nq + j.v)]] /= DEGREES
    if commands:
        scale_u[[c for j in joints for c in j.angles]] /= DEGREES
    return replace(
        windows, state=windows.state * scale_x, ctrl=windows.ctrl * scale_u, history=windows.history * scale_u
    )


def _flipped(windows: Windows, joint: Joint, states: bool, commands: bool) -> Windows:
    """A joint's positions and speeds negated, its commands, or both."""
    sign_x, sign_u = np.ones(windows.state.shape[2]), np.ones(windows.nu)
    sign_x[[joint.q, windows.nq + joint.v]] = -1.0 if states else 1.0
    sign_u[list(joint.ctrls)] = -1.0 if commands else 1.0
    return replace(windows, state=windows.state * sign_x, ctrl=windows.ctrl * sign_u, history=windows.history * sign_u)


def _swapped(windows: Windows, a: Joint, b: Joint, states: bool, commands: bool) -> Windows:
    """Two joints' positions and speeds exchanged, their commands, or both."""
    order_x, order_u = np.arange(windows.state.shape[2]), np.arange(windows.nu)
    if states:
        for x, y in ((a.q, b.q), (windows.nq + a.v, windows.nq + b.v)):
            order_x[[x, y]] = order_x[[y, x]]
    if commands and len(a.ctrls) == len(b.ctrls):
        order_u[[*a.ctrls, *b.ctrls]] = order_u[[*b.ctrls, *a.ctrls]]
    return replace(
        windows,
        state=windows.state[..., order_x],
        ctrl=windows.ctrl[..., order_u],
        history=windows.history[..., order_u],
    )
