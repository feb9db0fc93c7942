"""Rows of `nfpde bench devices`: what was measured on two devices, and whether the answers are the same."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import t as student

from nfpde.estimation.trajectory.estimator import STILL

CHANCE = 0.05
"""How often fits by softmax on two devices that do the same are called different."""

RULES = (
    f"trajectory: no robot's value differs by more than {STILL:g} standard deviations of the two fits together: as far "
    "as a search may still move when it stops",
    "softmax: the mean distances to the truth over all seeds differ by no more standard errors than chance leaves 19 "
    "of 20 times (Student's t; the errors from the spread over seeds on each device)",
    "diagnosis: the same verdict and the same causes, and every fitted value within the other's 95 % interval",
)
"""When answers are the same, in words."""


def softmax_row(what: str, here: list[dict[str, Any]], there: list[dict[str, Any]]) -> dict[str, Any]:
    """Fits of the same seeds, two or more, on both devices; each has `seconds` and `distance` to the truth."""
    a, b = (np.array([fit["distance"] for fit in fits]) for fits in (here, there))
    n = len(a)
    difference, error = b.mean() - a.mean(), float(np.sqrt((a.var(ddof=1) + b.var(ddof=1)) / n))
    most = float(student.ppf(1 - CHANCE / 2, 2 * n - 2))
    return {
        "what": f"{what}, {n} seeds",
        "seconds": [float(np.mean([fit["seconds"] for fit in fits])) for fits in (here, there)],
        "answers": [", ".join(f"{d:.3g}" for d in distances) + " from the truth" for distances in (a, b)],
        "apart": f"{difference:+.2g} in the mean, standard error {error:.2g}; {most:.2g} allowed; "
        f"at most {np.abs(b - a).max():.2g} by seed",
        "distances": [a.tolist(), b.tolist()],
        "same": bool(abs(difference) <= most * error),
    }


def trajectory_row(what: str, here: dict[str, Any], there: dict[str, Any]) -> dict[str, Any]:
    """The same fit on both devices.

    Each has `seconds`, `distance` to the truth, `converged`, and robots by parameters of `value` and `std`.
    """
    (a, a_std), (b, b_std) = ([np.array(fit[key]) for key in ("value", "std")] for fit in (here, there))
    apart = float(np.max(np.abs(a - b) / np.hypot(a_std, b_std)))
    return {
        "what": what,
        "seconds": [fit["seconds"] for fit in (here, there)],
        "answers": [
            f"{fit['distance']:.3g} from the truth" + ", stopped before it settled" * (not fit["converged"])
            for fit in (here, there)
        ],
        "apart": f"{apart:.2g} standard deviations at most; {STILL:g} allowed",
        "standard_deviations": apart,
        "same": apart <= STILL,
    }


def diagnosis_row(what: str, here: dict[str, Any], there: dict[str, Any]) -> dict[str, Any]:
    """The same diagnosis on both devices; each has `seconds`, `verdict`, `causes` with values, `parameters`, `left`."""
    differs = []
    if here["verdict"] != there["verdict"]:
        differs.append("another verdict")
    if sorted(here["causes"]) != sorted(there["causes"]):
        differs.append("other causes")
    values, others = ({k: v for table in _tables(d) for k, v in table.items()} for d in (here, there))
    both = [name for name in values if name in others]
    outside = [
        name for name in both if not (_within(values[name], others[name]) and _within(others[name], values[name]))
    ]
    if outside:
        differs.append("outside of the other's interval: " + ", ".join(outside))
    said = differs or [f"{len(both)} fitted values within each other's intervals" if both else "nothing was fitted"]
    left = ", ".join(f"{d['left']:.3g}" for d in (here, there))
    return {
        "what": what,
        "seconds": [d["seconds"] for d in (here, there)],
        "answers": [_in_words(d) for d in (here, there)],
        "apart": "; ".join([*said, f"gap left {left}"]),
        "same": not differs,
    }


def _tables(diagnosis: dict[str, Any]) -> list[dict[str, Any]]:
    """Fitted values by name: the base parameters, and each cause's."""
    causes = [{f"{cause} {name}": v for name, v in table.items()} for cause, table in diagnosis["causes"].items()]
    return [diagnosis["parameters"], *causes]


def _within(fitted: dict[str, float], other: dict[str, float]) -> bool:
    return other["low"] <= fitted["value"] <= other["high"]


def _in_words(diagnosis: dict[str, Any]) -> str:
    causes = []
    for cause, table in diagnosis["causes"].items():
        values = ", ".join(f"{name} {fitted['value']:.3g}" for name, fitted in table.items())
        causes.append(f"{cause} ({values})")
    return ", ".join([diagnosis["verdict"], *causes])
