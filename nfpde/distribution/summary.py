"""A distribution in one table: a row a parameter."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from nfpde.errors import BadInput
from nfpde.parameters import ParameterSpace

BOUND_ZONE, BOUND_SHARE = 0.01, 0.05
_NOTE = "share: from 5 % to 95 %, of the box; 90 % where the data said nothing"


@dataclass(frozen=True)
class ParameterSummary:
    """One parameter's marginal, in its unit.

    Args:
        name: As in the space.
        unit: As in the space, "" for none.
        low: Lower bound.
        high: Upper bound.
        nominal: The model's own value; None where it is not known.
        mean: Mean.
        std: Standard deviation.
        q05: 5 % quantile.
        q50: Median.
        q95: 95 % quantile.
        width_share: Width of the interval from q05 to q95 over the width of the box; 0.9 for a uniform marginal,
            so near 0.9 the data said nothing.
        leans_on: The bound in whose hundredth of the box more than 5 % of the samples lie: it may be set too tight.
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float | None
    mean: float
    std: float
    q05: float
    q50: float
    q95: float
    width_share: float
    leans_on: Literal["low", "high", "both"] | None


@dataclass(frozen=True)
class Summary:
    """One row a parameter, and the number of samples the figures come from."""

    parameters: tuple[ParameterSummary, ...]
    samples: int

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {"samples": self.samples, "parameters": [asdict(p) for p in self.parameters]}

    def __rich__(self) -> Table:
        """The table for a terminal."""
        table = Table(box=SIMPLE_HEAD, padding=(0, 1), caption=f"{self.samples} samples; {_NOTE}")
        nominal = any(p.nominal is not None for p in self.parameters)
        leaning = any(p.leans_on is not None for p in self.parameters)
        table.add_column("parameter", overflow="fold", min_width=12)
        for heading in [*["nominal"] * nominal, "mean", "5 %", "95 %", "low", "high", "share"]:
            table.add_column(heading, justify="right", no_wrap=True)
        if leaning:
            table.add_column("leans on")
        for p in self.parameters:
            name = f"{p.name} [{p.unit}]" if p.unit else p.name
            own = [_number(p.nominal)] * nominal
            figures = [_number(v) for v in (p.mean, p.q05, p.q95, p.low, p.high)]
            table.add_row(escape(name), *own, *figures, f"{p.width_share:.0%}", *[p.leans_on or ""] * leaning)
        return table


def summarise(space: ParameterSpace, xi: NDArray[np.float64], nominal: ArrayLike | None = None) -> Summary:
    """Summarise samples xi (n, D) of a distribution over `space`; `nominal` (D,) holds NaN where unknown."""
    try:
        own = np.full(len(space), np.nan) if nominal is None else np.asarray(nominal, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadInput(f"nominal must be {len(space)} numbers, one a parameter, got {nominal!r}") from None
    if own.shape != (len(space),):
        raise BadInput(f"nominal must have shape ({len(space)},), one value a parameter, got {own.shape}")
    mean, std = xi.mean(0), xi.std(0)
    q05, q50, q95 = np.quantile(xi, [0.05, 0.5, 0.95], axis=0)
    at_low = (xi < space.low + BOUND_ZONE * space.width).mean(0) > BOUND_SHARE
    at_high = (xi > space.high - BOUND_ZONE * space.width).mean(0) > BOUND_SHARE
    rows = [
        ParameterSummary(
            name=p.name,
            unit=p.unit,
            low=p.low,
            high=p.high,
            nominal=None if math.isnan(own[i]) else float(own[i]),
            mean=float(mean[i]),
            std=float(std[i]),
            q05=float(q05[i]),
            q50=float(q50[i]),
            q95=float(q95[i]),
            width_share=float((q95[i] - q05[i]) / space.width[i]),
            leans_on=_bound(bool(at_low[i]), bool(at_high[i])),
        )
        for i, p in enumerate(space)
    ]
    return Summary(tuple(rows), len(xi))


def _bound(low: bool, high: bool) -> Literal["low", "high", "both"] | None:
    if low and high:
        return "both"
    if low:
        return "low"
    return "high" if high else None


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
