"""Even steps from uneven ones, and pieces without gaps."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from nfpde.dataset.episode import Episode
from nfpde.dataset.quaternions import check_columns, check_lengths
from nfpde.dataset.timing import gap_rows
from nfpde.errors import BadDataset, BadInput

BRIDGE = 5.0
"""Longest step that resampling bridges when nothing else is said, in median steps."""

_ON_GRID = 1e-6
"""A recorded row this near to a new one is at the same time, in new steps: clocks are rounded."""


def resample_episode(
    episode: Episode,
    control_dt: float,
    *,
    quaternions: Sequence[int] = (),
    max_gap: float | None = None,
) -> Episode:
    """The recording at even steps of `control_dt`, from its first row on.

    Positions and velocities are interpolated linearly, unit quaternions along the shorter arc (slerp). Each
    command acts until the next one is recorded, and a new row has what acts from it to the next row, on
    average over time: exactly the recorded command where it is one all the way. The last row has the command
    that acts at its time. States are not filtered, and with a `control_dt` well above the recorded step only
    the average of many commands is left.

    Args:
        episode: The recording; its steps may be uneven.
        control_dt: New control step [s].
        quaternions: First qpos column of each unit quaternion (w, x, y, z); one for each column by which
            nq exceeds nv.
        max_gap: Longest recorded step to bridge [s]; None means `BRIDGE` median steps.

    Returns:
        A new episode of the same name and robot, ending at or before the last recorded time.

    Raises:
        BadDataset: A step is longer than `max_gap`, or the episode is shorter than one `control_dt`.
        BadInput: `control_dt`, `max_gap` or `quaternions` do not make sense.
    """
    check_seconds(control_dt, "control_dt")
    _check_quaternions(episode, quaternions)
    _check_gaps(episode, max_gap)
    steps = whole_steps(episode, control_dt)
    if steps < 1:
        raise BadDataset(
            f"episode {episode.name!r} lasts {episode.duration:.6g} s, less than one control step of {control_dt:.6g} "
            "s; resample to a smaller step, or remove the episode."
        )
    even = episode.time[0] + control_dt * np.arange(steps + 1)
    time = np.minimum(even, episode.time[-1])  # the last may lie beyond by a rounding error
    qpos = _interpolate(episode.time, episode.qpos, time)
    for first in quaternions:
        columns = slice(first, first + 4)
        qpos[:, columns] = _slerp(episode, columns, time)
    return Episode(
        name=episode.name,
        time=even,
        qpos=qpos,
        qvel=_interpolate(episode.time, episode.qvel, time),
        ctrl=_mean_commands(episode, control_dt, steps),
        robot=episode.robot,
    )


def whole_steps(episode: Episode, control_dt: float) -> int:
    """How many steps of `control_dt` [s] an episode lasts, but for rounding."""
    return int(np.floor(episode.duration / control_dt * (1 + 1e-9)))


def bridged_step(episode: Episode) -> float:
    """Longest step [s] that resampling bridges when nothing else is said: `BRIDGE` median steps."""
    return BRIDGE * float(np.median(np.diff(episode.time)))


def split_episode_at_gaps(episode: Episode, max_gap: float | None = None) -> list[Episode]:
    """The recording in pieces, cut wherever time is missing.

    Args:
        episode: The recording.
        max_gap: Longest step that is no gap [s]; None means 1.5 median steps.

    Returns:
        The episode itself where there is no gap, else pieces named `NAME/0`, `NAME/1`, ... Pieces of a
        single row hold no control step and are left out.

    Raises:
        BadDataset: No piece of two rows is left.
    """
    if max_gap is not None:
        check_seconds(max_gap, "max_gap")
    cuts = gap_rows(episode, max_gap).tolist()
    if not cuts:
        return [episode]
    ranges = [(a, b) for a, b in zip([0, *cuts], [*cuts, len(episode)], strict=True) if b - a > 1]
    if not ranges:
        raise BadDataset(
            f"episode {episode.name!r}: every step is a gap, so no piece of two rows is left; use a larger max_gap."
        )
    return [
        Episode(
            name=f"{episode.name}/{i}",
            time=episode.time[a:b],
            qpos=episode.qpos[a:b],
            qvel=episode.qvel[a:b],
            ctrl=episode.ctrl[a:b],
            robot=episode.robot,
        )
        for i, (a, b) in enumerate(ranges)
    ]


def check_seconds(value: float, name: str) -> None:
    """Refuse anything but a positive, finite number.

    Args:
        value: The argument [s].
        name: Its name, for the error text.

    Raises:
        BadInput: It is no positive, finite number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise BadInput(f"{name} is {value!r}; it must be a number of seconds.")
    if not (np.isfinite(value) and value > 0):
        raise BadInput(f"{name} is {value!r}; it must be a positive number of seconds.")


def _check_quaternions(episode: Episode, quaternions: Sequence[int]) -> None:
    needed = episode.nq - episode.nv
    if len(quaternions) != needed:
        raise BadInput(
            f"episode {episode.name!r} has nq={episode.nq} and nv={episode.nv}, so {needed} unit quaternion(s), and "
            f"quaternions={list(quaternions)}; give the first qpos column of each (3 for a free joint that comes "
            "first). Where a model says which, it must be the one that was recorded."
        )
    check_columns(quaternions, episode.nq)


def _check_gaps(episode: Episode, max_gap: float | None) -> None:
    if max_gap is None:
        max_gap = bridged_step(episode)
    check_seconds(max_gap, "max_gap")
    gaps = gap_rows(episode, max_gap)
    if len(gaps):
        row = int(gaps[0])
        raise BadDataset(
            f"episode {episode.name!r}, row {row}: {episode.time[row] - episode.time[row - 1]:.6g} s passed since "
            f"the row before, longer than max_gap={max_gap:.6g} s ({len(gaps)} such gap(s)); interpolating over it "
            "would invent data. Split the episode there (load_dataset(..., split_gaps=True), split_episode_at_gaps), "
            "or raise max_gap."
        )


def _mean_commands(episode: Episode, control_dt: float, steps: int) -> NDArray[np.float64]:
    """Time average of the command that acts from each new row to the next; the last row's at its time, (steps + 1, nu).

    With the one before it a late row would go on for nearly a whole step too long.
    """
    stamp = (episode.time - episode.time[0]) / control_dt
    near = np.round(stamp)
    stamp = np.where(np.abs(stamp - near) <= _ON_GRID, near, stamp)
    row = np.arange(steps + 1)
    at_row = episode.ctrl[np.searchsorted(stamp, row, side="right") - 1]
    # in each piece between these one command acts, of one row
    ends = np.union1d(row, stamp[stamp < steps])
    begin, length = ends[:-1], np.diff(ends)[:, None]
    acting = episode.ctrl[np.searchsorted(stamp, begin, side="right") - 1]
    # counted from the row's first command: what does not change is not rounded
    change = length * (acting - at_row[np.floor(begin).astype(int)])
    total = np.add.reduceat(change, np.searchsorted(begin, row[:-1]), axis=0)
    mean = at_row.copy()
    np.add(at_row[:-1], total, out=mean[:-1], where=total != 0)  # or -0 would become 0
    return mean


def _interpolate(old: NDArray[np.float64], values: NDArray[np.float64], new: NDArray[np.float64]) -> np.ndarray:
    after = np.clip(np.searchsorted(old, new, side="right"), 1, len(old) - 1)
    share = ((new - old[after - 1]) / (old[after] - old[after - 1]))[:, None]
    return (1 - share) * values[after - 1] + share * values[after]


def _slerp(episode: Episode, columns: slice, new: NDArray[np.float64]) -> NDArray[np.float64]:
    check_lengths(episode, columns)
    poses = Rotation.from_quat(episode.qpos[:, columns], scalar_first=True)
    return Slerp(episode.time, poses)(new).as_quat(scalar_first=True)
