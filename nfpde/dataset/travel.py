"""How far positions go, and how far their speeds say that they go."""

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset.dataset import Dataset

SPAN = 10
"""Rows over which changes of position and speeds are compared: far more than one row's, their noise is the same."""

_LEFT = 0.2
"""Share of the changes of a position that is left at most where speeds explain it."""


def changes_over_spans(
    dataset: Dataset, q: NDArray[np.intp], v: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Changes of positions over `SPAN` rows inside episodes, and what their speeds say they are.

    Args:
        dataset: The recordings.
        q: Columns of A positions in qpos.
        v: Columns of their speeds in qvel.

    Returns:
        Two arrays (S, A); the speed between two rows is the mean of theirs.
    """
    moved, told = [], []
    for episode in dataset:
        rows = np.append(np.arange(0, len(episode) - 1, SPAN), len(episode) - 1)
        steps = 0.5 * (episode.qvel[1:, v] + episode.qvel[:-1, v]) * dataset.control_dt
        travelled = np.vstack([np.zeros(len(v)), np.cumsum(steps, axis=0)])
        moved.append(np.diff(episode.qpos[rows][:, q], axis=0))
        told.append(np.diff(travelled[rows], axis=0))
    return np.concatenate(moved), np.concatenate(told)


def explained(moved: NDArray[np.float64], told: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether positions change as their speeds say, of every axis: (S, A) twice to (A,)."""
    return ((moved - told) ** 2).sum(0) < _LEFT * (moved**2).sum(0)
