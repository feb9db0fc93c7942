"""Fitted values as they stand in a report: with intervals, and a flag where one leans on the end of its range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Quantity
from nfpde.gap.certainty import INTERVAL
from nfpde.gap.fit import Fit
from nfpde.gap.report import Fitted

Array = NDArray[np.float64]

_MARGIN = 1e-3
"""Share of the bounds within which a value lies at their end."""


def fitted_values(
    fit: Fit, errors: Array, columns: slice, names: Sequence[str], quantities: Sequence[Quantity] = ()
) -> dict[str, Fitted]:
    """Values with 95 % intervals, by name.

    Args:
        fit: Where they come from.
        errors: Standard errors of all its free parameters (D,).
        columns: Which of these.
        names: What to call them.
        quantities: Of the effect whose they are, as it is bound to the model; none where they are no effect's. Where
            a bound is the value that does nothing, the value has gone as far as there is anything to say, and leans on
            nothing; nor does one that only shapes the effect.
    """
    replay, error = fit.replay, errors[columns]
    out = {}
    for i, (name, p) in enumerate(zip(names, replay.parameters[columns], strict=True)):
        value, low, high = float(fit.xi[columns][i]), p.low, p.high
        margin, span = _MARGIN * (high - low), INTERVAL * float(error[i])
        neutral = quantities[i].neutral if quantities else np.nan
        ends = [end for end in (low, high) if abs(value - end) < margin and not abs(neutral - end) <= margin]
        leans = bool(ends) and not (quantities and quantities[i].shape_only)
        out[name] = Fitted(value, max(low, value - span), min(high, value + span), p.unit or "-", leans)
    return out
