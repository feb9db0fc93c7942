"""Velocities of recordings that have none, from their positions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nfpde.dataset.columns import ColumnNames
from nfpde.dataset.dataset import Dataset
from nfpde.dataset.episode import Episode
from nfpde.dataset.quaternions import check_columns, check_lengths
from nfpde.errors import BadDataset

Array = NDArray[np.float64]

COMPUTED = {"velocities": "differences of the positions"}
"""What the metadata's conventions say of recordings whose velocities `load_dataset` took from their positions."""

_ROUNDED = 1e-5
"""Share of the highest speed by which a speed that was computed from positions differs from that: single precision."""


def differentiate_episode(episode: Episode, quaternions: Sequence[int] = ()) -> Episode:
    """The recording with velocities taken from its positions, whatever it has.

    Central differences of second order, also over uneven steps, and one-sided ones in the first and the last row; of
    unit quaternions the angular velocity in the body's own frame, as MuJoCo has it for free and ball joints. They say
    less than a sensor of the speeds does: what lasts less than two rows is blurred, and each of an encoder's steps
    counts as a speed of up to half a step per row.

    Args:
        episode: The recording.
        quaternions: First qpos column of each unit quaternion (w, x, y, z).

    Returns:
        A new episode with nv = nq less the number of quaternions.

    Raises:
        BadDataset: An angle that was wrapped, or a quaternion of length zero.
        BadInput: Quaternions beyond the columns.
    """
    check_columns(quaternions, episode.nq)
    turning = {first + k for first in quaternions for k in range(4)}
    plain = [column for column in range(episode.nq) if column not in turning]
    steps = np.diff(episode.time)[:, None]
    changes = np.diff(episode.qpos, axis=0)
    _check_wraps(episode, changes, plain)
    for first in quaternions:
        columns = slice(first, first + 4)
        check_lengths(episode, columns)
        poses = Rotation.from_quat(episode.qpos[:, columns], scalar_first=True)
        changes[:, first : first + 3] = (poses[:-1].inv() * poses[1:]).as_rotvec()
    kept = [column for column in range(episode.nq) if column - 3 not in quaternions]
    return replace(episode, qvel=_at_rows(changes[:, kept] / steps, steps))


def differentiated(dataset: Dataset, quaternions: Sequence[int] = ()) -> Dataset:
    """The same positions with velocities taken from them, whatever it has, which the data set says then.

    Args:
        dataset: Recordings.
        quaternions: See `differentiate_episode`.
    """
    said = replace(dataset.metadata, conventions={**dataset.metadata.conventions, **COMPUTED})
    return replace(dataset, episodes=[differentiate_episode(e, quaternions) for e in dataset], metadata=said)


def names_with_velocities(names: ColumnNames, quaternions: Sequence[int]) -> ColumnNames:
    """Names of the columns after `differentiate_episode`: the positions', of each quaternion the first three."""
    if names.qpos is None:
        return replace(names, qvel=None)
    kept = tuple(name for column, name in enumerate(names.qpos) if column - 3 not in quaternions)
    return replace(names, qvel=kept)


def says_computed(dataset: Dataset) -> bool:
    """Whether recordings say that `differentiate_episode` made their velocities."""
    return dataset.metadata.conventions.get("velocities") == COMPUTED["velocities"]


def computed_velocities(dataset: Dataset, axes: Sequence[tuple[int, int]]) -> NDArray[np.intp]:
    """Velocities that nobody measured: all of them, where the recordings say so, or those that are central differences.

    Of one-sided differences this says nothing: simulations in single steps of Euler's method have them, too.

    Args:
        dataset: The recordings.
        axes: Columns in qpos and in qvel of positions whose speeds are looked at.

    Returns:
        Columns in qvel.
    """
    if says_computed(dataset):
        return np.arange(dataset.nv)
    columns = np.array(axes, dtype=np.intp).reshape(-1, 2)
    ends = np.cumsum([len(episode) for episode in dataset])
    inside = np.ones(ends[-1] - 1, dtype=bool)
    inside[ends[:-1] - 1] = False
    qpos, qvel = (np.concatenate([getattr(e, name) for e in dataset]) for name in ("qpos", "qvel"))
    ways = difference_ways(qpos[:, columns[:, 0]], qvel[:, columns[:, 1]], inside, dataset.control_dt)
    return columns[[way == "central" for way in ways], 1]


def difference_ways(qpos: Array, qvel: Array, inside: NDArray[np.bool_], control_dt: float) -> list[str]:
    """By which difference of positions each speed can be computed to the last digits: nobody measured it then.

    Args:
        qpos: Positions of all rows (R, A).
        qvel: Their speeds (R, A).
        inside: Whether the step from a row to the next lies inside an episode (R-1,).
        control_dt: The step [s].

    Returns:
        "backward", "forward", "central" or "" for each.
    """
    step, speed = np.diff(qpos, axis=0) / control_dt, qvel[1:-1]
    inner = inside[1:] & inside[:-1]
    ways = {"backward": step[:-1], "forward": step[1:], "central": 0.5 * (step[:-1] + step[1:])}
    found = []
    for k in range(qpos.shape[1]):
        at = speed[inner, k]
        scale = _ROUNDED * float(np.abs(at).max(initial=0.0))
        exact = [way for way, values in ways.items() if scale and np.abs(values[inner, k] - at).max() <= scale]
        found.append(exact[0] if exact else "")
    return found


def _at_rows(rates: Array, steps: Array) -> Array:
    """Rates of rows from those between them (T - 1, nv): the parabola through three rows, lines at the ends."""
    share = steps[:-1] / (steps[:-1] + steps[1:])
    inner = (1.0 - share) * rates[:-1] + share * rates[1:]
    return np.concatenate([rates[:1], inner, rates[-1:]])


def _check_wraps(episode: Episode, changes: Array, columns: Sequence[int]) -> None:
    """Refuse jumps by half a turn or more between rows that the steps before and after do not show.

    Raises:
        BadDataset: Where the first is, and what to do.
    """
    for column in columns:
        change = changes[:, column]
        around = np.pad(change, 1, mode="edge")
        apart = np.minimum(np.abs(change - around[:-2]), np.abs(change - around[2:]))
        if len(change) > 1:  # the first and the last have one neighbour
            apart[0], apart[-1] = abs(change[0] - change[1]), abs(change[-1] - change[-2])
        jumps = np.flatnonzero((np.abs(change) > np.pi) & (apart > np.pi))
        if len(jumps):
            row = int(jumps[0])
            before, after = episode.qpos[row : row + 2, column]
            raise BadDataset(
                f"episode {episode.name!r}, row {row + 1}, column qpos_{column}: {after:.4g} follows {before:.4g}, "
                f"{len(jumps)} such jump(s), and no velocity can be taken from them. Undo wrapped angles with "
                "np.unwrap in every episode; split the episode where a reading is wrong."
            )
