"""Memory for arrays that live long among others that do not."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Shelf:
    """Arrays in one block of memory, the oldest of which make room.

    Thousands that lived as long by themselves would pin the heap around what is made and dropped in the meantime.

    Args:
        most: Numbers that it holds.
    """

    def __init__(self, most: int) -> None:
        self._block, self._next = np.empty(most), 0
        self._held: OrderedDict[Hashable, tuple[int, tuple[int, ...]]] = OrderedDict()

    def get(self, name: Hashable) -> Array | None:
        """What lies under a name, until the next is put there; None if nothing does."""
        held = self._held.get(name)
        if held is None:
            return None
        start, shape = held
        return self._block[start : start + int(np.prod(shape))].reshape(shape)

    def put(self, name: Hashable, array: Array) -> None:
        """Hold an array under a name that is new; not an empty one, nor one that is larger than the block."""
        if not 0 < array.size <= self._block.size:
            return
        if self._next + array.size > self._block.size:
            self._clear(self._next, self._block.size)
            self._next = 0
        self._clear(self._next, self._next + array.size)
        self._block[self._next : self._next + array.size] = array.ravel()
        self._held[name] = self._next, array.shape
        self._next += array.size

    def _clear(self, start: int, end: int) -> None:
        """Forget what lies from a place to another: it was put there in turn, and is the oldest."""
        while self._held:
            name, (at, shape) = next(iter(self._held.items()))
            if at >= end or at + int(np.prod(shape)) <= start:
                break
            del self._held[name]
