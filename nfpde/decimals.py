"""Numbers for people, as precisely as they are known."""

from __future__ import annotations

import math

_MOST = 7
"""Significant digits of a value that is known better than anyone reads."""


def places_of(error: float, value: float = 0.0) -> int:
    """Places behind the point up to the second digit of an error above zero; less than none in front of it.

    Of a value no more than seven digits are told, however well it is known.
    """
    places = 1 - math.floor(math.log10(error))
    return min(places, _MOST - 1 - math.floor(math.log10(abs(value)))) if value else places


def rounded(value: float, places: int) -> str:
    """A finite number to so many places behind the point, zeros written; what rounds to nothing is 0, without a sign.

    Powers of ten are written below 1e-4 and from a million on.
    """
    near = round(value, places)
    if near == 0:
        return "0"
    first = math.floor(math.log10(abs(near)))
    if -5 < first < 6:
        return f"{near:.{max(places, 0)}f}"
    return f"{near:.{max(first + places, 0)}e}"
