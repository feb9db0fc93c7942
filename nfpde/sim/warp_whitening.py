"""Costs of whole recordings on a Warp device: a whitening that stays there, applied batch by batch."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from nfpde.kernels import whitening as kernels
from nfpde.sim.whitening import DIVERGED, Whitening

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class WarpWhitening:
    """A whitening on a device; `costs` takes the batches of a call in order.

    Args:
        whitening: of all windows of the call.
        device: where residuals are.
    """

    def __init__(self, whitening: Whitening, device: wp.Device) -> None:
        self.whitening, self.device = whitening, device
        with wp.ScopedDevice(device):
            self._own = wp.array(np.ascontiguousarray(whitening.own), dtype=wp.float64)
            self._carry = wp.array(np.ascontiguousarray(whitening.carry), dtype=wp.float64)
            self._linked = wp.array(whitening.linked.astype(np.int32), dtype=int)
            self._before = wp.zeros(whitening.channels, dtype=wp.float64)

    def costs(self, residual: wp.array, white: wp.array, vector: Index, window: Index, *, continues: bool) -> Array:
        """Costs of the K vectors of a batch, of its rows only, (K,).

        Args:
            residual: of the rows, (at least R, C).
            white: as large; overwritten with the innovations.
            vector: vector of each row, from 0 to K - 1, sorted, (R,).
            window: window of each row, in the order of the whitening, (R,).
            continues: whether the first rows are of the vector that the last call ended with.
        """
        rows, channels = len(vector), self.whitening.channels
        # every recording of a vector is a chain of its own, that no other waits for
        starts = np.flatnonzero((np.diff(vector, prepend=-1) != 0) | ~self.whitening.linked[window])
        with wp.ScopedDevice(self.device):
            windows = wp.array(window.astype(np.int32), dtype=int)
            first = wp.array(np.append(starts, rows).astype(np.int32), dtype=int)
            cost = wp.zeros(len(starts), dtype=wp.float64)
            wp.launch(
                kernels._whiten_alone, dim=(rows, channels), inputs=[residual, self._own, windows], outputs=[white]
            )
            wp.launch(
                kernels._sum_costs,
                dim=len(starts),
                inputs=[
                    *(self._carry, self._linked, windows, first, self._before),
                    *(int(continues), self.whitening.degrees, DIVERGED),
                ],
                outputs=[white, cost],
            )
            wp.copy(self._before, white, src_offset=(rows - 1) * channels, count=channels)
            found = np.zeros(int(vector[-1]) + 1)
            np.add.at(found, vector[starts], cost.numpy())
            return found
