"""Single readings that break with all others: angles that were wrapped, and spikes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.errors import BadDataset
from nfpde.gap.grain import step_of
from nfpde.gap.readings import Readings

Array = NDArray[np.float64]

_MAD = 1.4826
"""Ratio of standard deviation to median absolute deviation of a Gaussian."""

_FAR = 20.0
"""Standard deviations beyond which no noise reaches: in a million rows, Laplace's, with its long tails, has one
reading so far off in one recording of eight hundred, a Gaussian's never."""

_NEAR = 10
"""Rows before and after a reading whose mismatch must be small beside it, too: noise may come with the motion."""

_THROW = 2.0
"""A blow throws a part off at no more than twice the speed of what hits it."""

_JUMP = 10.0
"""A change of speed so many times the usual is a blow; it shakes the other joints as well."""

_NOT_A_TURN = np.pi / 4
"""What is further from a whole number of turns is none [rad]."""


def check_wraps(readings: Readings) -> None:
    """Refuse angles that jump by whole turns where their speed shows nothing of it.

    Raises:
        BadDataset: Which joint's, where first, how often, and what to do.
    """
    mismatch = readings.mismatch
    for k, axis in enumerate(readings.axes):
        if not axis.turns:
            continue
        jumps = _turned(readings, mismatch[:, k], k)
        if len(jumps):
            episode, row = readings.place[jumps[0] + 1]
            raise BadDataset(
                f"{axis.name}: its qpos jumps by whole turns that its qvel does not show, {len(jumps)} time(s), first "
                f"in episode {episode!r} at row {row}, from {readings.qpos[jumps[0], k]:.4g} to "
                f"{readings.qpos[jumps[0] + 1, k]:.4g} rad: the angle was wrapped. Undo it with np.unwrap in every "
                f"episode, before any resampling"
            )


def check_spikes(readings: Readings) -> None:
    """Refuse single readings that are far off, where those around and the other sensor of the joint deny them.

    Raises:
        BadDataset: Which joint's, where first, how often, and what to do.
    """
    mismatch = readings.mismatch
    struck = _blows(readings)
    for k, axis in enumerate(readings.axes):
        for group, other, rows in (
            ("qpos", "qvel", _position_spikes(readings, mismatch[:, k], k)),
            ("qvel", "qpos", _speed_spikes(readings, mismatch[:, k], k, struck)),
        ):
            if len(rows):
                episode, row = readings.place[rows[0]]
                values = (readings.qpos if group == "qpos" else readings.qvel)[rows[0] - 1 : rows[0] + 2, k]
                raise BadDataset(
                    f"{axis.name}: {len(rows)} reading(s) of its {group} are spikes, first in episode {episode!r} at "
                    f"row {row} ({', '.join(f'{v:.4g}' for v in values)}, from the row before to the row after): the "
                    f"rows around and the {other} deny them. Interpolate over them, or split the episodes there"
                )


def _turned(readings: Readings, mismatch: Array, k: int) -> NDArray[np.intp]:
    """Steps in which an angle was wrapped; of a wrap that resampling has spread over two, the first."""
    whole, least = 2 * np.pi, 2 * np.pi - _NOT_A_TURN
    pair = mismatch[:-1] + mismatch[1:]
    one = np.flatnonzero(np.abs(mismatch) > least)
    halves = (np.abs(mismatch[:-1]) < least) & (np.abs(mismatch[1:]) < least) & (mismatch[:-1] * mismatch[1:] > 0)
    two = np.flatnonzero((np.abs(pair) > least) & halves)
    if not len(one) and not len(two):
        return one
    apart = mismatch - whole * np.round(mismatch / whole)
    found = []
    for steps, jump, width in ((one, mismatch[one], 1), (two, pair[two], 2)):
        noise = _FAR * _spread_at(readings, apart, k, steps, width)
        allowed = noise + readings.control_dt * _range(readings.qvel[:, k], steps)
        rest = np.abs(jump - whole * np.round(jump / whole))
        found.append(steps[(rest < np.minimum(allowed, _NOT_A_TURN)) & (noise < whole)])
    return np.sort(np.concatenate(found))


def _position_spikes(readings: Readings, mismatch: Array, k: int) -> NDArray[np.intp]:
    """Rows whose position jumps away and back in the next, further than any speed of these rows could take it."""
    size = np.where(mismatch[:-1] * mismatch[1:] < 0, np.minimum(np.abs(mismatch[:-1]), np.abs(mismatch[1:])), 0.0)
    steps = np.flatnonzero(size > 0)
    steps = steps[size[steps] > _THROW * readings.control_dt * _range(readings.qvel[:, k], steps)]
    return _beyond_noise(readings, mismatch, k, steps, size)


def _speed_spikes(readings: Readings, mismatch: Array, k: int, struck: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Rows whose speed is further from both neighbours' than any that the positions have ever shown.

    In a blow a joint may be fast for a moment in which it does not get far; then other joints are hit, too, and it may
    be thrown by the fastest of them. Alone, it may be thrown back as fast as it came.
    """
    size = np.where(mismatch[:-1] * mismatch[1:] > 0, np.minimum(np.abs(mismatch[:-1]), np.abs(mismatch[1:])), 0.0)
    steps = np.flatnonzero(size > 0)
    speed = readings.qvel[:, k]
    low, high = np.minimum(speed[steps], speed[steps + 2]), np.maximum(speed[steps], speed[steps + 2])
    beyond = np.abs(speed[steps + 1] - np.clip(speed[steps + 1], low, high))
    alike = [i for i, a in enumerate(readings.axes) if a.turns == readings.axes[k].turns]
    others = np.delete(struck, k, axis=1).sum(1)
    blow = others[steps] + others[steps + 1] + others[steps + 2] > 0
    shown = readings.fastest
    alone = np.maximum(shown[k], _THROW * np.maximum(np.abs(low), np.abs(high)))
    far = beyond > np.where(blow, _THROW * shown[alike].max(), alone)
    return _beyond_noise(readings, mismatch, k, steps[far], size)


def _beyond_noise(
    readings: Readings, mismatch: Array, k: int, steps: NDArray[np.intp], size: Array
) -> NDArray[np.intp]:
    """Rows in the middle of the two steps that begin at `steps`, where `size` is beyond the noise of the mismatch."""
    if not len(steps):
        return steps
    return steps[size[steps] > _FAR * _spread_at(readings, mismatch, k, steps, 2)] + 1


def _blows(readings: Readings) -> NDArray[np.bool_]:
    """Whether the speed of an axis breaks at a row (R, A)."""
    turn = np.zeros_like(readings.qvel)
    turn[1:-1] = np.abs(readings.qvel[1:-1] - 0.5 * (readings.qvel[2:] + readings.qvel[:-2]))
    return turn > _JUMP * _MAD * np.median(turn, axis=0)


def _spread_at(readings: Readings, mismatch: Array, k: int, steps: NDArray[np.intp], width: int) -> Array:
    """Standard deviation of a mismatch (R-1,), robust, for the `width` steps that begin at each of `steps` (n,).

    The largest of that in all rows; of that before or after; of the grain of the sensors. Mismatches of exactly zero
    do not count in all rows: an encoder that stands still shows no noise at all, then one step of its grain.
    """
    some = np.abs(mismatch[mismatch != 0]) if mismatch.any() else np.zeros(1)
    before = np.clip(steps[:, None] - np.arange(1, _NEAR + 1), 0, None)
    after = np.clip(steps[:, None] + width + np.arange(_NEAR), None, len(mismatch) - 1)
    near = np.maximum(*(np.median(np.abs(mismatch[side]), axis=1) for side in (before, after)))
    grain = max(step_of(readings.qpos[:, k]), step_of(readings.qvel[:, k]) * readings.control_dt)
    return np.maximum(_MAD * np.maximum(np.median(some), near), grain / np.sqrt(6.0))


def _range(speed: Array, steps: NDArray[np.intp]) -> Array:
    """Range of the speeds (R,) in the rows around steps: from one before to two after where they end."""
    near = [speed[np.clip(steps + shift, 0, len(speed) - 1)] for shift in range(-1, 4)]
    return np.ptp(near, axis=0)
