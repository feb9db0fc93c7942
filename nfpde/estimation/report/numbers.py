"""How the page writes what was estimated."""

from __future__ import annotations

import math

from nfpde.decimals import places_of, rounded


def number(value: float) -> str:
    """Three significant digits."""
    return f"{value:.3g}" if math.isfinite(value) else "unknown"


def with_std(value: float, std: float) -> str:
    """A value and its standard deviation, to the second digit of the latter; fit.json has all digits."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0):
        return f"{number(value)} ± {number(std)}"
    return f"{rounded(value, places_of(std, value))} ± {rounded(std, places_of(std))}"
