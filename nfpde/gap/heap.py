"""Memory that was freed, and lies between what is still in use."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache


def give_back() -> None:
    """Return what lies free to the operating system, where the C library is glibc; elsewhere nothing is done.

    glibc keeps what lies below anything that is in use. Arrays of some MB that are made and dropped by the thousand,
    while a few live on, leave a heap several times as large as what is in it.
    """
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Callable[[int], int] | None:
    """`malloc_trim`, or None where there is none."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, TypeError, AttributeError):  # no C library to ask (TypeError: Windows), or another one
        return None
