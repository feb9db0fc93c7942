"""Whether time is in seconds: positions change by their speeds times the time that passes."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset
from nfpde.elements import is_axis
from nfpde.errors import BadDataset

_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds in the units in which clocks count."""

_SPAN = 10
"""Rows over which changes are compared: far more than one row's, their noise is the same."""

_EXPLAINS = 0.2
"""Share of the changes of a position that speeds leave which explain it."""


def check_seconds_of_clock(model: mujoco.MjModel, dataset: Dataset) -> None:
    """Refuse a clock that does not count in seconds.

    Args:
        model: Says which columns of qpos and qvel belong together.
        dataset: Recordings in the model's order.

    Raises:
        BadDataset: No position changes as its speed says, and some do if time is in ms, us or ns.
    """
    joints = np.array([j for j in range(model.njnt) if is_axis(model, j)], dtype=int)
    moved, told = _moves(dataset, model.jnt_qposadr[joints], model.jnt_dofadr[joints])
    if _explained(moved, told).any():
        return
    for unit, seconds in _UNITS.items():
        if _explained(moved, seconds * told).any():
            raise BadDataset(
                f"time looks recorded in {unit}: positions change by {seconds:g} times their speeds times the time "
                f"that passes, {dataset.control_dt:g} from row to row. Multiply time by {seconds:g}; it must be in "
                f"seconds"
            )


def _moves(
    dataset: Dataset, q: NDArray[np.intp], v: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Changes of positions over `_SPAN` rows, and what their speeds say they are, (S, A) each."""
    moved, told = [], []
    for episode in dataset:
        rows = np.append(np.arange(0, len(episode) - 1, _SPAN), len(episode) - 1)
        steps = 0.5 * (episode.qvel[1:, v] + episode.qvel[:-1, v]) * dataset.control_dt
        travelled = np.vstack([np.zeros(len(v)), np.cumsum(steps, axis=0)])
        moved.append(np.diff(episode.qpos[rows][:, q], axis=0))
        told.append(np.diff(travelled[rows], axis=0))
    return np.concatenate(moved), np.concatenate(told)


def _explained(moved: NDArray[np.float64], told: NDArray[np.float64]) -> NDArray[np.bool_]:
    return ((moved - told) ** 2).sum(0) < _EXPLAINS * (moved**2).sum(0)
