"""The residuals of whole robots: every recording of one robot is explained by one parameter vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset, Windows
from nfpde.errors import BadDataset
from nfpde.losses import increment_scale
from nfpde.sim import Simulator

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Problem:
    """Windows sorted by robot, and their residuals in units of how much each channel changes over a window.

    names: label of every robot                                          (G,)
    members: indices of each robot's windows                             G arrays
    unit: what a residual of 1 stands for in each channel                (C,)
    """

    simulator: Simulator
    windows: Windows
    names: tuple[str, ...]
    members: tuple[Index, ...]
    unit: Array

    @property
    def channels(self) -> int:
        """Numbers in a window's residual, C = H x ndiff."""
        return len(self.unit)

    def residuals(self, xi: Array, robot: Sequence[int] | Index) -> list[Array]:
        """Predicted minus measured, scaled: vectors (K, D), vector k on all windows of robot[k], to K arrays (n_k, C).

        A window whose simulation diverged holds NaN.
        """
        counts = np.array([len(self.members[g]) for g in robot])
        vector = np.repeat(np.arange(len(xi)), counts)
        window = np.concatenate([self.members[g] for g in robot])
        predicted = self.simulator.rollout(xi, self.windows, vector, window)
        difference = self.simulator.states.difference(predicted, self.windows.target[window])
        return np.split(difference.reshape(len(vector), -1) / self.unit, np.cumsum(counts)[:-1])


def make_problem(simulator: Simulator, dataset: Dataset, horizon: int) -> Problem:
    """Cut a data set into windows that do not overlap and sort them by robot (by episode where robots have no label).

    Raises:
        BadDataset: a robot whose episodes are all shorter than the horizon.
    """
    windows = dataset.windows(horizon, history=simulator.history_steps(dataset.control_dt))
    labels = [e.robot if e.robot is not None else f"episode {e.name}" for e in dataset]
    names = tuple(dict.fromkeys(labels))
    owner = np.array([names.index(label) for label in labels])[windows.episode]
    members = tuple(np.flatnonzero(owner == g) for g in range(len(names)))
    short = [name for name, m in zip(names, members, strict=True) if not len(m)]
    if short:
        raise BadDataset(f"{short[0]} has no window of {horizon} control steps; shorten the horizon or leave it out")
    unit = np.tile(increment_scale(simulator.states, windows), horizon)
    return Problem(simulator, windows, names, members, unit)
