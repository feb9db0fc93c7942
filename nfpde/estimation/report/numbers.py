"""How the page writes what was estimated."""

from __future__ import annotations

import math

from nfpde.decimals import places_of, rounded

_MOST = 7
"""Significant digits of a value that is known better than anyone reads; fit.json has all of them."""


def number(value: float) -> str:
    """Three significant digits."""
    return f"{value:.3g}" if math.isfinite(value) else "unknown"


def with_std(value: float, std: float) -> str:
    """A value and its standard deviation, to the second digit of the latter, but to no more than seven of the value."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0):
        return f"{number(value)} ± {number(std)}"
    told = places_of(std)
    most = _MOST - 1 - math.floor(math.log10(abs(value))) if value else told
    return f"{rounded(value, min(told, most))} ± {rounded(std, told)}"
