"""What recordings say about themselves before any simulation: a joint's speed is the change of its position."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset
from nfpde.dataset.travel import changes_over_spans, explained
from nfpde.elements import element_names, is_axis, listed
from nfpde.errors import BadDataset
from nfpde.gap.grain import step_of

Array = NDArray[np.float64]

CURED = 0.2
"""A change of recordings that brings an error below this share of it was the cause."""

DEGREES = 180.0 / np.pi
"""Degrees in a radian."""

_UNIT = 0.1
"""How far a ratio of position to speed may be from that of degrees, as a share: scales of sensors are off by less."""

_TOGGLES = 2.5
"""Steps of its encoder that a resting joint's readings differ by at most: two, with rounding."""

_NO_CHANCE = 6.0
"""Standard errors of a correlation (of Fisher's transform) that chance does not make: one in a billion."""


@dataclass(frozen=True)
class Axis:
    """A position that moves along a line or turns about one: a hinge, a slide, a free joint's translation.

    name: of the joint, with .x, .y or .z for a free one's
    q, v: its columns in qpos and qvel
    turns: whether it is an angle
    """

    name: str
    q: int
    v: int
    turns: bool


@dataclass(frozen=True, eq=False)
class Readings:
    """All rows of a data set, one episode after the other, A axes side by side.

    axes: the axes
    place: episode's name and row of every row
    qpos, qvel: positions and speeds (R, A)
    inside: whether the step from a row to the next lies inside an episode (R-1,)
    moved, told: changes of position over stretches of rows, and what the speeds say they are (S, A)
    control_dt: [s]
    """

    axes: tuple[Axis, ...]
    place: tuple[tuple[str, int], ...]
    qpos: Array
    qvel: Array
    inside: NDArray[np.bool_]
    moved: Array
    told: Array
    control_dt: float

    @classmethod
    def of(cls, model: mujoco.MjModel, dataset: Dataset) -> Readings:
        """Those of recordings in the model's order."""
        axes = axes_of(model)
        lengths = [len(e) for e in dataset]
        ends = np.cumsum(lengths)
        inside = np.ones(ends[-1] - 1, dtype=bool)
        inside[ends[:-1] - 1] = False
        q, v = np.array([(a.q, a.v) for a in axes], dtype=int).reshape(-1, 2).T
        return cls(
            axes,
            tuple((e.name, row) for e in dataset for row in range(len(e))),
            np.concatenate([e.qpos for e in dataset])[:, q],
            np.concatenate([e.qvel for e in dataset])[:, v],
            inside,
            *changes_over_spans(dataset, q, v),
            dataset.control_dt,
        )

    @property
    def mismatch(self) -> Array:
        """Change of position less mean speed times the control step, from row to row (R-1, A); 0 between episodes."""
        travel = 0.5 * (self.qvel[1:] + self.qvel[:-1]) * self.control_dt
        return (np.diff(self.qpos, axis=0) - travel) * self.inside[:, None]

    @property
    def fastest(self) -> Array:
        """Highest mean speed of every axis from one row to the next, as its positions show it (A,)."""
        return np.abs(np.diff(self.qpos, axis=0) * self.inside[:, None]).max(0) / self.control_dt

    def never_changing(self) -> list[Axis]:
        """Axes whose position and speed are the same in all rows of every episode."""
        changes = (np.abs(np.diff(self.qpos, axis=0)) + np.abs(np.diff(self.qvel, axis=0)))[self.inside]
        return [self.axes[k] for k in np.flatnonzero(changes.max(0, initial=0.0) == 0)]


def axes_of(model: mujoco.MjModel) -> tuple[Axis, ...]:
    """The axes of a model, in the order of its joints."""
    out = []
    for i, name in enumerate(element_names(model, "joint")):
        q, v, kind = int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i]), model.jnt_type[i]
        if is_axis(model, i):
            out.append(Axis(name, q, v, kind == mujoco.mjtJoint.mjJNT_HINGE))
        elif kind == mujoco.mjtJoint.mjJNT_FREE:
            out += [Axis(f"{name}.{letter}", q + k, v + k, False) for k, letter in enumerate("xyz")]
    return tuple(out)


def check_columns(readings: Readings) -> None:
    """Refuse speeds that are not the changes of their positions: of the wrong sign, column or unit, or not recorded.

    Raises:
        BadDataset: Which joint's, and what to do.
    """
    moved, told = readings.moved, readings.told
    _check_order(readings.axes, moved, told)
    _check_signs(readings, moved, told)
    _check_units(readings.axes, moved, told)


def _check_signs(readings: Readings, moved: Array, told: Array) -> None:
    fits = explained(moved, told)  # as they do where a body is thrown, or coasts at one speed
    for k, axis in enumerate(readings.axes):
        speed = readings.qvel[:, k]
        if not np.ptp(moved[:, k]) > 0:
            continue
        constant = not np.ptp(speed) > 0 and not fits[k]
        if constant and _leaves(readings, k):
            raise BadDataset(
                f"{axis.name}: its qpos changes while its qvel stands still at {speed[0]:g}; record velocities, or "
                f"take them from differences of qpos"
            )
        if np.ptp(told[:, k]) > 0 and _against(moved[:, k], told[:, k]):
            raise BadDataset(
                f"{axis.name}: its qvel runs against the change of its qpos, so one of the two has the wrong sign; "
                f"correct it in the recordings"
            )


def _leaves(readings: Readings, k: int) -> bool:
    """Whether a position leaves its place: by more than an encoder toggles between neighbouring steps at rest."""
    starts = np.concatenate([[0], np.flatnonzero(~readings.inside) + 1])
    at = readings.qpos[:, k]
    widest = np.max(np.maximum.reduceat(at, starts) - np.minimum.reduceat(at, starts))
    return bool(widest > _TOGGLES * step_of(at))


def _against(moved: Array, told: Array) -> bool:
    """Whether speeds say the opposite of what positions do, by more than chance makes of noise at rest."""
    agree = float(np.clip(np.corrcoef(moved, told)[0, 1], -0.999999, 0.999999))
    return agree < -0.5 and np.arctanh(agree) * np.sqrt(max(len(moved) - 3, 0)) < -_NO_CHANCE


def _check_order(axes: tuple[Axis, ...], moved: Array, told: Array) -> None:
    """Positions that change as the speeds of other joints say, and not as their own, stand in another order."""
    total = (moved**2).sum(0)
    apart = total[:, None] + (told**2).sum(0) - 2 * moved.T @ told  # change of row's qpos against column's qvel
    own = np.diag(apart)
    follows = {}
    for k in range(len(axes)):
        nearest = int(np.argmin(apart[k]))
        if apart[k, nearest] < CURED * min(own[k], total[k]):
            follows[k] = nearest
    while set(follows) != set(follows.values()):  # in the end every column has one owner: the columns were permuted
        follows = {k: n for k, n in follows.items() if n in follows and k in follows.values()}
    if follows:
        says = ", ".join(f"that of {axes[k].name} follows the qvel of {axes[n].name}" for k, n in follows.items())
        raise BadDataset(
            f"{listed([axes[k].name for k in follows])} stand in different columns of qpos and qvel: of the change "
            f"of qpos, {says}. Swap the columns in one of the two, so that both have the model's order"
        )


def _check_units(axes: tuple[Axis, ...], moved: Array, told: Array) -> None:
    """Where either positions or speeds are in degrees, their ratio tells."""
    for group, factor in (("qpos", DEGREES), ("qvel", 1 / DEGREES)):
        wrong = []
        for k, axis in enumerate(axes):
            total, own = (moved[:, k] ** 2).sum(), ((moved[:, k] - told[:, k]) ** 2).sum()
            apart = ((moved[:, k] - factor * told[:, k]) ** 2).sum()
            ratio = np.sqrt(total / max((told[:, k] ** 2).sum(), 1e-300))
            if axis.turns and apart < CURED * min(own, total) and abs(np.log(ratio / factor)) < _UNIT:
                wrong.append(axis.name)
        if wrong:
            looks = "looks" if len(wrong) == 1 else "look"
            raise BadDataset(
                f"{listed(wrong)}: the {group} {looks} recorded in degrees: qpos changes {factor:.3g} times as "
                f"fast as qvel says. Convert {group} to {'rad' if group == 'qpos' else 'rad/s'}"
            )
