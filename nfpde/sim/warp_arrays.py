"""Arrays on a Warp device: their first rows, and all those of a dataclass."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray


def arrays_of(thing: Any) -> list[wp.array]:
    """All arrays of a dataclass of Warp's, nested ones included."""
    found = []
    for f in dataclasses.fields(thing):
        value = getattr(thing, f.name)
        if isinstance(value, wp.array):
            found.append(value)
        elif dataclasses.is_dataclass(value):
            found += arrays_of(value)
    return found


def first(array: wp.array, count: int) -> NDArray[Any]:
    """The first rows of an array, without sending the rest; without a GPU they are its own memory."""
    rows: Any = array[:count]
    return np.asarray(rows.numpy())


def fetched(array: wp.array) -> NDArray[Any]:
    """The values of an array, in memory that is the caller's own; one that lies transposed is sent as it lies."""
    rows: Any = array
    turned = not rows.is_contiguous
    values = np.asarray((rows.transpose() if turned else rows).numpy())
    # what comes from a GPU is a copy; without one it is the array's own memory
    own = values if rows.device.is_cuda else values.copy()
    return own.T if turned else own


def fill(array: wp.array, values: NDArray[Any]) -> None:
    """Copy values into the first rows of an array; no world reads the rest."""
    if values.size:
        rows: Any = array[: len(values)]
        rows.assign(np.ascontiguousarray(values))
