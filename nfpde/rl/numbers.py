"""Whole numbers among the arguments, Python's and NumPy's."""

from __future__ import annotations

from typing import Any

import numpy as np

from nfpde.errors import BadInput


def seed_number(seed: Any) -> int:
    """A seed as Python's own number, in the range that every generator in use takes.

    Raises:
        BadInput: no whole number, a truth value, or one outside of the range.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise BadInput(f"seed is {seed!r}; it must be an integer from 0 to {2**63 - 1}")
    return int(seed)


def whole_number(name: str, value: Any, least: int, why: str = "") -> int:
    """A whole number as Python's own, which JSON can hold.

    Args:
        name: of the argument, with which the message of an error begins.
        value: what was given.
        least: the smallest that makes sense.
        why: reason for it, the end of the message.

    Raises:
        BadInput: no whole number, a truth value, or less than the least.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise BadInput(f"{name} is {value!r}; it must be a whole number, at least {least}{why}")
    return int(value)
