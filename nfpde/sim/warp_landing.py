"""Bringing answers back from a GPU: into page-locked memory, which numpy reads where it is.

Into other memory the driver copies in pieces through a buffer of its own, and fresh memory has to be mapped page by
page. At 100 000 losses no difference was measured on an H200; 1e6 took 0.9 ms by the other way, of 166.
"""

from __future__ import annotations

from typing import Any
from weakref import finalize

import numpy as np
import warp as wp
from numpy.typing import NDArray

from nfpde.sim.warp_device import ran_out
from nfpde.sim.warp_sizes import power_of_two

KEPT = 4
"""Buffers that nobody reads which are kept for the next answers; making one takes as long as filling many."""

MOST_BYTES = 1 << 30
"""Page-locked memory at most, which the rest of the machine has to do without."""

_free: list[wp.array] = []
_lent: list[int] = []
"""Bytes of each buffer that somebody reads."""


class _Loan:
    """A buffer as numpy takes it over; it comes back when the last array that shows it is gone."""

    def __init__(self, buffer: wp.array, shape: tuple[int, ...], dtype: Any) -> None:
        self.__array_interface__ = {
            "data": (buffer.ptr, False),
            "shape": shape,
            "typestr": np.dtype(dtype).str,
            "version": 3,
        }
        _lent.append(buffer.capacity)
        # at the end of the process there is nobody to give it back to
        finalize(self, _give_back, buffer).atexit = False


def fetched(array: wp.array) -> NDArray[Any]:
    """The values of an array of numbers, in memory that is the caller's own; of a GPU's array, page-locked."""
    device: Any = array.device
    if not device.is_cuda:
        return np.array(array.numpy())
    buffer = _buffer(array.size * wp.types.type_size_in_bytes(array.dtype)) if array.is_contiguous else None
    if buffer is None:
        return np.asarray(array.numpy())
    landed: Any = wp.array(ptr=buffer.ptr, shape=array.shape, dtype=array.dtype, device="cpu", pinned=True)
    with wp.ScopedDevice(device):
        wp.copy(landed, array)
        wp.synchronize_stream(wp.get_stream(device))
    return np.asarray(_Loan(buffer, array.shape, wp.dtype_to_numpy(array.dtype)))


def _buffer(nbytes: int) -> wp.array | None:
    """A buffer that is large enough, but not by far; None where that is too much page-locked memory."""
    size = power_of_two(max(nbytes, 1))
    for i, buffer in enumerate(_free):
        if buffer.capacity == size:
            return _free.pop(i)
    held = sum(_lent) + sum(b.capacity for b in _free)
    if held + size > MOST_BYTES:
        return None
    number: Any = wp.uint8
    try:
        return wp.empty(size, dtype=number, device="cpu", pinned=True)
    except RuntimeError as error:
        if not ran_out(error):
            raise
        return None


def _give_back(buffer: wp.array) -> None:
    _lent.remove(buffer.capacity)
    _free.append(buffer)
    del _free[:-KEPT]
