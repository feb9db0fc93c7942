"""Whether time is in seconds: positions change by their speeds times the time that passes."""

from __future__ import annotations

import mujoco
import numpy as np

from nfpde.dataset import Dataset
from nfpde.dataset.travel import changes_over_spans, explained
from nfpde.elements import is_axis
from nfpde.errors import BadDataset

_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds in the units in which clocks count."""


def check_seconds_of_clock(model: mujoco.MjModel, dataset: Dataset) -> None:
    """Refuse a clock that does not count in seconds.

    Args:
        model: Says which columns of qpos and qvel belong together.
        dataset: Recordings in the model's order.

    Raises:
        BadDataset: No position changes as its speed says, and some do if time is in ms, us or ns.
    """
    joints = np.array([j for j in range(model.njnt) if is_axis(model, j)], dtype=int)
    moved, told = changes_over_spans(dataset, model.jnt_qposadr[joints], model.jnt_dofadr[joints])
    if explained(moved, told).any():
        return
    for unit, seconds in _UNITS.items():
        if explained(moved, seconds * told).any():
            raise BadDataset(
                f"time looks recorded in {unit}: positions change by {seconds:g} times their speeds times the time "
                f"that passes, {dataset.control_dt:g} from row to row. Multiply time by {seconds:g}; it must be in "
                f"seconds"
            )
