"""Sending a call's parameters to a device through memory of which it copies by itself, while the host goes on."""

from __future__ import annotations

from typing import Any

import warp as wp
from numpy.typing import NDArray

from nfpde.sim.warp_arrays import fill

MOST_NUMBERS = 1 << 20
"""Of a host copy that is kept; more of them take longer on their way than it saves."""


class Inbox:
    """An array on Warp's current device and, unless it is large, page-locked memory from which its rows are sent.

    Whoever sends again must know that what was sent before has arrived.

    Args:
        shape: (rows, numbers).
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.array = wp.zeros(shape, dtype=float)
        self._host: Any = None
        if 0 < self.array.size <= MOST_NUMBERS and wp.get_device().is_cuda:
            self._host = wp.zeros(shape, dtype=float, device="cpu", pinned=True)
            self._view: NDArray[Any] = self._host.numpy()

    def send(self, rows: NDArray[Any]) -> None:
        """Send the first rows; nobody reads the rest."""
        if self._host is None:
            fill(self.array, rows)
        else:
            self._view[: len(rows)] = rows
            wp.copy(self.array, self._host, count=rows.size)
