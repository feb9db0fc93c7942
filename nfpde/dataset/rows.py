"""Between a file's rows, every episode one below the other, and episodes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset.arrays import LARGEST_EXACT_INTEGER, frozen_floats, plain_array
from nfpde.dataset.episode import Episode
from nfpde.errors import BadDataset


def episodes_of_rows(*, episode: Any, time: Any, qpos: Any, qvel: Any, ctrl: Any, robot: Any = None) -> list[Episode]:
    """Cut a file's rows into episodes.

    Args:
        episode: Label of each row's episode, whole numbers or text. Shape (R,).
        time: Times [s]. Shape (R,).
        qpos: Positions. Shape (R, nq).
        qvel: Velocities. Shape (R, nv).
        ctrl: Commands. Shape (R, nu).
        robot: Label of each row's robot, "" where there is none; None for a file without. Shape (R,).

    Returns:
        The episodes in the order of the file, even steps not checked.

    Raises:
        BadDataset: The arrays differ in length, an episode's rows do not lie together, one episode has two
            robots, or an episode breaks a rule of its own.
    """
    labels = label_texts(episode, "episode")
    robots = None if robot is None else label_texts(robot, "robot")
    numbers = {
        "time": frozen_floats(time, "time", 1),
        "qpos": frozen_floats(qpos, "qpos", 2),
        "qvel": frozen_floats(qvel, "qvel", 2),
        "ctrl": frozen_floats(ctrl, "ctrl", 2),
    }
    lengths = {name: len(array) for name, array in numbers.items()}
    if robots is not None:
        lengths["robot"] = len(robots)
    for name, length in lengths.items():
        if length != len(labels):
            raise BadDataset(
                f"{name} has {length} rows and episode has {len(labels)}; every array needs the same number of rows."
            )
    if not len(labels):
        raise BadDataset("there are no rows; a data set holds at least one episode of two rows.")

    starts = np.concatenate([[0], np.flatnonzero(labels[1:] != labels[:-1]) + 1])
    ends = np.append(starts[1:], len(labels))
    _check_contiguous(labels, starts)
    episodes = []
    for a, b in zip(starts.tolist(), ends.tolist(), strict=True):
        name = str(labels[a])
        try:
            pieces = {field: array[a:b] for field, array in numbers.items()}
            episodes.append(Episode(name=name, robot=_one_robot(robots, a, b, name), **pieces))
        except BadDataset as error:
            raise BadDataset(f"{error} (Episode {name!r} begins at row {a} of the file, counted from 0.)") from None
    return episodes


def rows_of_episodes(episodes: Sequence[Episode]) -> dict[str, NDArray[Any]]:
    """Join episodes into the arrays that a file holds.

    Args:
        episodes: The recordings.

    Returns:
        Arrays `episode` (R,) (int64 where every name is a plain number, else text),
        `time` (R,), `qpos` (R, nq), `qvel` (R, nv), `ctrl` (R, nu),
        and `robot` (R,) text where at least one episode has a robot.
    """
    lengths = [len(e) for e in episodes]
    plain = all(is_whole_number(e.name) for e in episodes)
    labels = np.array([e.name for e in episodes])
    rows: dict[str, NDArray[Any]] = {"episode": np.repeat(labels.astype(np.int64) if plain else labels, lengths)}
    if any(e.robot is not None for e in episodes):
        rows["robot"] = np.repeat(np.array([e.robot or "" for e in episodes]), lengths)
    for field in ("time", "qpos", "qvel", "ctrl"):
        rows[field] = np.concatenate([getattr(e, field) for e in episodes])
    return rows


def label_texts(labels: Any, what: str) -> NDArray[np.str_]:
    """Labels as text; a whole number becomes its digits.

    Args:
        labels: Text, or whole numbers of any type. Shape (R,).
        what: "episode" or "robot", for the error text.

    Returns:
        The labels. Shape (R,).

    Raises:
        BadDataset: Not one dimension, or numbers that are not whole (or too large for their type).
    """
    array = plain_array(labels, what)
    if array.ndim != 1:
        raise BadDataset(f"{what} has shape {array.shape}; it must have one dimension, one label a row.")
    if array.dtype.kind == "U":
        return array
    if array.dtype.kind not in "iuf":
        raise BadDataset(f"{what} holds values of type {array.dtype}; labels are whole numbers or text.")
    if array.dtype.kind == "f":
        wrong = ~((array == np.round(array)) & (np.abs(array) <= LARGEST_EXACT_INTEGER))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise BadDataset(
                f"row {row}, column {what}: {array[row]} is no whole number; labels are whole numbers or text."
            )
        array = array.astype(np.int64)
    return array.astype(str)


def is_whole_number(name: str) -> bool:
    """Whether a name is what a whole number of at most 15 digits (below 2**53) would become."""
    return len(name) < 16 and name.isdecimal() and str(int(name)) == name


def _check_contiguous(labels: NDArray[np.str_], starts: NDArray[np.int64]) -> None:
    _, first = np.unique(labels[starts], return_index=True)
    if len(first) == len(starts):
        return
    again = int(np.setdiff1d(np.arange(len(starts)), first)[0])
    name = labels[starts[again]]
    earlier = int(np.flatnonzero(labels[starts] == name)[0])
    raise BadDataset(
        f"episode {str(name)!r} begins at row {starts[earlier]} and again at row {starts[again]}, with other episodes "
        "between; an episode's rows must lie together. Sort the rows by episode and time, or rename one part."
    )


def _one_robot(robots: NDArray[np.str_] | None, a: int, b: int, name: str) -> str | None:
    if robots is None:
        return None
    other = np.flatnonzero(robots[a:b] != robots[a])
    if len(other):
        raise BadDataset(
            f"episode {name!r}, row {other[0]}, column robot: {str(robots[a + other[0]])!r} where the episode began "
            f"with {str(robots[a])!r}; one episode is of one robot. Begin a new episode there."
        )
    return str(robots[a]) or None
