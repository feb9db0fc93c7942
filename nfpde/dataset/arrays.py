"""Arrays as a data set keeps them: float64, C-contiguous, read-only, of a stated number of dimensions."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.errors import BadDataset

LARGEST_EXACT_INTEGER = 2**53  # every integer up to here is a float64, beyond it some are not
_DIMENSIONS = {1: "one dimension", 2: "two dimensions (rows, columns)", 3: "three dimensions"}


def frozen_floats(value: Any, what: str, ndim: int) -> NDArray[np.float64]:
    """The numbers of `value` as a read-only float64 array.

    A read-only C-contiguous float64 array is taken as it is; anything else is copied, so that a later
    change of the caller's array changes nothing here.

    Args:
        value: Array or nested sequence of numbers.
        what: What the array is, as the error text should call it ("episode '3': qpos").
        ndim: Number of dimensions it must have.

    Returns:
        The array, float64, C-contiguous, not writeable.

    Raises:
        BadDataset: The values are no real numbers, are integers that float64 cannot hold, or the number
            of dimensions is wrong.
    """
    array = plain_array(value, what)
    if array.dtype.kind not in "fiub":
        raise BadDataset(f"{what} holds {_kind(array.dtype)}; it must hold real numbers. Convert it to float64 first.")
    if array.ndim != ndim:
        raise BadDataset(f"{what} has shape {array.shape}; it must have {_DIMENSIONS[ndim]}.")
    if array.dtype.kind in "iu" and array.size:
        largest = max(abs(int(array.max())), abs(int(array.min())))
        if largest > LARGEST_EXACT_INTEGER:
            raise BadDataset(
                f"{what} holds the integer {largest} (sign dropped), beyond 2**53, where float64 rounds. Time "
                "is in seconds: subtract the first stamp as an integer, then divide (nanoseconds by 1e9)."
            )
    if array.dtype == np.float64 and array.flags.c_contiguous and not array.flags.writeable:
        return array
    with np.errstate(over="ignore"):  # a wider float too large for float64 becomes inf, which is refused
        copy = np.array(array, dtype=np.float64, order="C")
    copy.setflags(write=False)
    return copy


def plain_array(value: Any, what: str) -> NDArray[Any]:
    """`value` as an array that holds no Python objects.

    Args:
        value: Array or nested sequence.
        what: What the array is, for the error text.

    Returns:
        The array; not copied where it was one already.

    Raises:
        BadDataset: A ragged nested sequence, an array of Python objects, or one that is masked in part.
    """
    if np.ma.is_masked(value):  # what lies under a mask would count
        raise BadDataset(f"{what} is masked in part; split the episode where values are missing.")
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as error:
        raise BadDataset(f"{what} is no array of equal rows ({error}); make every row equally long.") from None
    if array.dtype.hasobject:
        raise BadDataset(
            f"{what} holds Python objects, which would have to be unpickled and could run code; "
            "save it again as a plain array of numbers (or of text, for labels)."
        )
    return array


def _kind(dtype: np.dtype[Any]) -> str:
    names = {"U": "text", "S": "bytes", "M": "dates", "m": "time differences", "c": "complex numbers"}
    return names.get(dtype.kind, f"values of type {dtype}")
