"""Arrays on a Warp device: their first rows, and all those of a dataclass."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from nfpde.sim.warp_landing import fetched


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
    return fetched(rows) if rows.device.is_cuda else np.asarray(rows.numpy())


def fill(array: wp.array, values: NDArray[Any]) -> None:
    """Copy values into the first rows of an array; no world reads the rest."""
    if values.size:
        rows: Any = array[: len(values)]
        rows.assign(np.ascontiguousarray(values))
