"""Recordings that cannot answer, or do not fit the model: joints with flipped signs, joints swapped, nothing moving."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.elements import actuator_ctrls, element_names, is_axis
from nfpde.errors import BadDataset, SimulationDiverged
from nfpde.gap.overlap import always_touching, bodies_of, without_contacts
from nfpde.gap.recordings import Recordings
from nfpde.gap.replay import Replay
from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]

_WINDOWS = 60
_CURED = 0.2
"""A change of sign or order that brings the error below this share of it was the cause."""

_DIVERGED = 1e6
"""Error of a window whose simulation diverges."""

_FITS = 0.01
"""A model whose error is below this share of the motion has the right signs and order: one wrong joint of forty would
make more."""

_MOST_PAIRS = 70

_PARTS = (("", True, True), (" in qpos and qvel", True, False), (" in the commands", False, True))
"""What may be flipped or swapped of a joint: how to say it, whether its states are, whether its commands are."""


@dataclass(frozen=True)
class _Joint:
    """A hinge or slide and the commands of its actuators."""

    name: str
    q: int
    v: int
    ctrls: tuple[int, ...]


def check_fit(replay: Replay, recordings: Recordings, xi: Array) -> None:
    """Refuse recordings in which a joint's sign or order differs from the model's, or nothing moves.

    Args:
        replay: The nominal model.
        recordings: The recordings.
        xi: Nominal free parameters (D,).

    Raises:
        BadDataset: What looks wrong, and what to do.
        SimulationDiverged: Its simulation diverges.
    """
    windows = recordings.fit[np.unique(np.linspace(0, len(recordings.fit) - 1, _WINDOWS).astype(int))]
    model = replay.sim.model
    joints = _joints(model)
    moved = np.abs(windows.state - windows.state[:, :1]).max((0, 1))
    if not (moved > 0).any():
        raise BadDataset(
            "nothing moves in these recordings, so no gap can be told from no gap: record the robot moving, every "
            "joint through a good part of its range, at several speeds"
        )
    _check_velocities(windows, joints)
    error = _error(replay, xi, windows)
    if error >= _DIVERGED:
        raise SimulationDiverged(
            "the nominal model's simulation diverges from most recorded states within "
            f"{windows.horizon * windows.control_dt:.3g} s, so it predicts nothing: halve its timestep "
            f"({replay.sim.model.opt.timestep:g} s), try another integrator (implicitfast), and look for springs that "
            "push, gains too high, and tiny masses; recordings must be in rad and m"
        )
    _check_contacts(replay, xi, windows, error)
    if error < _FITS:
        return
    flips = [
        (f"{j.name}'s sign looks flipped{of}", _flipped(windows, j, *parts)) for j in joints for of, *parts in _PARTS
    ]
    pairs = list(combinations(joints, 2))[:_MOST_PAIRS]
    swaps = [
        (f"{a.name} and {b.name} look swapped{of}", _swapped(windows, a, b, *p)) for a, b in pairs for of, *p in _PARTS
    ]
    trials = [(_error(replay, xi, changed), text) for text, changed in [*flips, *swaps]]
    if trials and min(trials)[0] < _CURED * error:
        best, text = min(trials)
        raise BadDataset(
            f"the recordings do not fit the model: {text} (the nominal model's error is {error:.2g} times the motion "
            f"as recorded, {best:.2g} times so changed). Correct the recordings or the model; the model has the joints "
            f"{', '.join(element_names(model, 'joint'))}"
        )


def _joints(model: mujoco.MjModel) -> list[_Joint]:
    on_joints = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    out = []
    for i, name in enumerate(element_names(model, "joint")):
        if is_axis(model, i):
            drives = np.flatnonzero(on_joints & (model.actuator_trnid[:, 0] == i))
            ctrls = tuple(int(c) for c in actuator_ctrls(model, drives)) if len(drives) else ()
            out.append(_Joint(name, int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i]), ctrls))
    return out


def _check_velocities(windows: Windows, joints: list[_Joint]) -> None:
    """A joint's speed must be the change of its position."""
    for joint in joints:
        change = np.diff(windows.state[:, :, joint.q], axis=1).ravel()
        speed = windows.state[:, :, windows.nq + joint.v]
        speed = 0.5 * (speed[:, 1:] + speed[:, :-1]).ravel()
        if change.std() > 0 and speed.std() > 0 and np.corrcoef(change, speed)[0, 1] < -0.5:
            raise BadDataset(
                f"{joint.name}: its qvel runs against the change of its qpos, so one of the two has the wrong sign; "
                f"correct it in the recordings"
            )
        if change.std() > 0 and speed.std() == 0:
            raise BadDataset(
                f"{joint.name}: its qpos changes while its qvel stands still at {speed[0]:g}; record velocities, or "
                f"take them from differences of qpos"
            )


def _check_contacts(replay: Replay, xi: Array, windows: Windows, error: float) -> None:
    """Geoms that overlap in every recorded pose, and push the model where the robot was not, shall not collide."""
    model = replay.sim.model
    pairs = always_touching(model, windows.state[:, 0, : model.nq])
    if not pairs:
        return
    space = ParameterSpace(replay.parameters) if replay.parameters else None
    apart = _error(Replay(without_contacts(model, pairs), space, []), xi, windows)
    if apart < _CURED * error:
        raise BadDataset(
            f"the recordings do not fit the model: in every recorded pose its geoms overlap, and their contact drives "
            f"it away (the nominal model's error is {error:.2g} times the motion, {apart:.2g} times without these "
            f"contacts): {bodies_of(model, pairs)}. Exclude the contacts (<exclude body1= body2=> in <contact>; MuJoCo "
            f"ignores contacts of parent and child, but not with a parent that is fixed to the world), or correct the "
            f"zeros of the joints"
        )


def _error(replay: Replay, xi: Array, windows: Windows) -> float:
    """Median over windows of the squared error at the end, in units of the motion's spread."""
    states = replay.sim.states
    predicted = replay.predict(xi[None], windows)[0][:, -1]
    moved = states.difference(windows.target[:, -1], windows.state[:, 0])
    error = states.difference(predicted, windows.target[:, -1])
    spread = np.sqrt((moved**2).mean(0))
    spread = np.maximum(spread, 1e-3 * spread.max(initial=0.0) + 1e-12)
    return float(np.median(np.nan_to_num(((error / spread) ** 2).mean(1), nan=_DIVERGED)))


def _flipped(windows: Windows, joint: _Joint, states: bool, commands: bool) -> Windows:
    """A joint's positions and speeds negated, its commands, or both."""
    sign_x, sign_u = np.ones(windows.state.shape[2]), np.ones(windows.nu)
    sign_x[[joint.q, windows.nq + joint.v]] = -1.0 if states else 1.0
    sign_u[list(joint.ctrls)] = -1.0 if commands else 1.0
    return replace(windows, state=windows.state * sign_x, ctrl=windows.ctrl * sign_u, history=windows.history * sign_u)


def _swapped(windows: Windows, a: _Joint, b: _Joint, states: bool, commands: bool) -> Windows:
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
