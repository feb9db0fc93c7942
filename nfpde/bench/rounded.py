"""Double precision whose predictions are changed by as much as single precision rounds them.

What a fit makes of these is what any device may make of it: the yardstick for answers of a device in single precision.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.parameters import ParameterSpace
from nfpde.sim import MujocoSimulator
from nfpde.sim.alike import ModelSource

Array = NDArray[np.float64]

PRECISION = float(np.finfo(np.float32).eps)


class RoundedSimulator(MujocoSimulator):
    """MuJoCo on the CPU, every predicted number off by a random 1.2e-7 of itself (standard deviation).

    That is the least that single precision does: errors of one step of the physics, without what contacts make of them.

    Args:
        model, space: see `MujocoSimulator`.
        seed: of the changes, which are others in every call.
    """

    def __init__(self, model: ModelSource | Sequence[ModelSource], space: ParameterSpace, seed: int) -> None:
        self._rng = np.random.default_rng(seed)  # before the checks, which simulate
        super().__init__(model, space)
        self.rounding = PRECISION

    def rollout(self, xi: Array, windows: Windows, vector: NDArray[np.intp], window: NDArray[np.intp]) -> Array:
        """See `Simulator.rollout`."""
        states = super().rollout(xi, windows, vector, window)
        return states * (1 + PRECISION * self._rng.standard_normal(states.shape))
