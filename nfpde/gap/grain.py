"""The steps of encoders, read off their readings, and what no sensor read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.elements import is_axis

Array = NDArray[np.float64]

_SAME = 1e-9
"""Readings that differ by less than this share of their range are one: rounding."""

_LEAST_STEPS, _OFTEN = 8, 10
"""Steps between neighbouring readings from which a grain is told, at least; fewer will do where rows are so many times
as many: a robot at rest shows few readings, again and again."""

_ALIKE = 1e-3
"""Share by which the steps that episodes tell may differ and be one."""

_PARTS, _WHOLE = 3, 1e-2
"""Parts of the shortest step that are tried for the grain, which may never occur alone; how near to a whole number of
them, in shortest steps, every step is."""


@dataclass(frozen=True, eq=False)
class Encoders:
    """What the readings in recorded states tell of the encoders, by column of the states.

    steps: what readings are multiples of, give or take a constant; 0 where of nothing (nq+nv,)
    rest: the reading that most rows have; NaN where there is none (nq+nv,)
    flips: share of the rows in which a reading at rest shows the next step up, and down, for one row (2, nq+nv)
    computed: what velocities that nobody measured take of the positions around, see `Differences.weights` (nv, 3);
        None where all were measured
    """

    steps: Array
    rest: Array
    flips: Array
    computed: Array | None = None

    @classmethod
    def of(cls, episodes: Sequence[Array], computed: Array | None = None) -> Encoders:
        """Of all that was recorded, as a robot that rests shows two readings of an encoder now and then.

        Args:
            episodes: States of each, (rows, nq+nv).
            computed: What velocities take of the positions around (nv, 3); None, or zeros, where they were measured.
        """
        read = np.concatenate(episodes)
        steps = np.array([_step([e[:, column] for e in episodes]) for column in range(read.shape[1])])
        rest = np.array([_most_read(column) for column in read.T])
        flips = np.zeros((2, len(steps)))
        for column in np.flatnonzero((steps > 0) & np.isfinite(rest)):
            parts = [np.round((e[:, column] - rest[column]) / steps[column]) for e in episodes]
            flips[:, column] = _flips(parts)
        return cls(steps, rest, flips, computed if computed is not None and computed.any() else None)

    @property
    def loose(self) -> NDArray[np.bool_] | None:
        """Channels that nobody measured (2 nv,); None where there are none."""
        if self.computed is None:
            return None
        return np.concatenate([np.zeros(len(self.computed), bool), self.computed.any(1)])

    def grain(self, model: mujoco.MjModel) -> Array:
        """Step of the readings of hinges, slides and velocities (2 nv,); zero where they are not multiples of one."""
        grain = np.zeros(2 * model.nv)
        for dof, joint in enumerate(model.dof_jntid):
            if is_axis(model, int(joint)):
                grain[dof] = self.steps[model.jnt_qposadr[joint]]
            grain[model.nv + dof] = self.steps[model.nq + dof]
        return grain

    def resting(self, model: mujoco.MjModel) -> NDArray[np.bool_]:
        """Which hinges and slides read the same in most rows, by degree of freedom (nv,)."""
        return np.array(
            [is_axis(model, int(j)) and np.isfinite(self.rest[model.jnt_qposadr[j]]) for j in model.dof_jntid], bool
        )


def _most_read(values: Array) -> float:
    """The value that more than half of all (n,) have, give or take rounding; NaN if none."""
    readings = np.sort(values)
    same = np.diff(readings) <= _SAME * (readings[-1] - readings[0])
    ends = np.flatnonzero(~np.concatenate([[False], same, [False]]))
    longest = int(np.diff(ends).argmax())
    return float(readings[ends[longest]]) if np.diff(ends)[longest] > len(readings) / 2 else np.nan


def _flips(episodes: Sequence[Array]) -> tuple[float, float]:
    """Share of the rows between two rows at rest that read one step more, and one less; readings in steps from rest."""
    between = [e[1:-1][(e[:-2] == 0) & (e[2:] == 0)] for e in episodes]
    middle = np.concatenate(between)
    return (float((middle == 1).mean()), float((middle == -1).mean())) if len(middle) else (0.0, 0.0)


def _step(episodes: Sequence[Array]) -> float:
    """What the readings of a column are multiples of, in most episodes, give or take a constant of each.

    Each counts for as many readings as it shows: one joint held at two places shows no step of its encoder, and one
    reading that is off, or an encoder that was zeroed anew, is no word on all others.
    """
    told = [(step_of(values), len(np.unique(values))) for values in episodes]
    votes = [(step, sum(n for other, n in told if abs(other - step) < _ALIKE * step)) for step, _ in told if step > 0]
    if votes:
        return max(votes, key=lambda vote: (vote[1], -vote[0]))[0]
    return _whole_of(np.concatenate([_differences(values) for values in episodes]), sum(map(len, episodes)))


def step_of(values: Array) -> float:
    """What values (n,) are multiples of, give or take a constant; zero if nothing."""
    return _whole_of(_differences(values), len(values))


def _differences(values: Array) -> Array:
    """Between neighbouring ones of all different readings, without rounding."""
    readings = np.unique(values)
    steps = np.diff(readings)
    return steps[steps > _SAME * (readings[-1:] - readings[:1])]


def _whole_of(steps: Array, rows: int) -> float:
    """What differences (n,) of the readings in so many rows are multiples of; zero if nothing."""
    if not len(steps) or _LEAST_STEPS > len(steps) >= rows / _OFTEN:
        return 0.0
    shortest = float(steps.min())
    for part in range(1, _PARTS + 1):
        parts = steps * part / shortest
        if np.abs(parts - np.round(parts)).max() < _WHOLE * part:
            return shortest / part
    return 0.0
