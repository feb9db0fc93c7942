"""Velocities that nobody measured, or not as they are: what they are of the positions in the rows around them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset
from nfpde.dataset.velocities import difference_ways, says_computed
from nfpde.elements import listed
from nfpde.gap.readings import Readings, axes_of

Array = NDArray[np.float64]

WAYS = {"backward": (-1.0, 1.0, 0.0), "forward": (0.0, -1.0, 1.0), "central": (-0.5, 0.0, 0.5)}
"""What a velocity takes of the positions in the row before, its own and the next, over a control step."""


@dataclass(frozen=True, eq=False)
class Differences:
    """How the velocities of recordings were computed from their positions.

    weights: of the positions in the row before, the same and the next, over a control step (nv, 3); zeros where a
        velocity was measured
    said: the joints whose velocities were computed, and the way, in words; "" where there are none
    late: by how much which velocities had been late, in words, where they were left out for that; else ""
    """

    weights: Array
    said: str
    late: str = ""

    @property
    def sentence(self) -> str:
        """What to tell a roboticist; "" where all velocities were measured, and count."""
        if not self.said:
            return ""
        alone = (
            "What counts is the positions alone, whatever velocity a window begins with, and that shows less: record"
        )
        if self.late:
            return (
                f"The velocities run behind the positions, as a filter makes them: by {self.late}. They were left out. "
                f"{alone} velocities without a filter, or positions at a higher rate."
            )
        return (
            f"Nobody measured the velocities of {self.said}: they are differences of the positions. {alone} "
            "velocities, too, or positions at a higher rate."
        )

    @classmethod
    def of(cls, model: mujoco.MjModel, dataset: Dataset) -> Differences:
        """Where the recordings say so, or velocities are differences of the positions to the last digits.

        Args:
            model: Says which columns belong to which joint.
            dataset: Recordings in the model's order.
        """
        weights, axes = np.zeros((model.nv, 3)), axes_of(model)
        if says_computed(dataset):
            weights[:] = WAYS["central"]
            return cls(weights, listed([f"{axis.name} (central)" for axis in axes] or ["all bodies"]))
        if not axes:
            return cls(weights, "")
        readings = Readings.of(model, dataset)
        ways = difference_ways(readings.qpos, readings.qvel, readings.inside, readings.control_dt)
        # recordings of a simulation in single steps: MuJoCo itself moves positions by the speeds of the next row
        usual = "backward" if dataset.control_dt < 1.5 * model.opt.timestep else ""
        found = [(axis, way) for axis, way in zip(axes, ways, strict=True) if way not in ("", usual)]
        for axis, way in found:
            weights[axis.v] = WAYS[way]
        return cls(weights, listed([f"{axis.name} ({way})" for axis, way in found]) if found else "")
