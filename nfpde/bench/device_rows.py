"""Rows of `nfpde bench devices`: what was measured on two devices, and whether the answers are the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from nfpde.estimation.trajectory.estimator import STILL

CHANCE = 0.05
"""How often fits by softmax on two devices that do the same are called different."""

RULES = (
    f"trajectory: no robot's value differs by more than {STILL:g} standard deviations of the two fits together, as far "
    "as a search may still move when it stops; robots whose value on A moves farther than that when its predictions "
    "are changed by single precision's rounding error are not judged, and both distances are told",
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


def trajectory_row(
    what: str, here: dict[str, Any], there: dict[str, Any], rounded: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """The same fit on both devices.

    Args:
        what: of the row.
        here: `seconds`, `distance` to the truth, `converged`, and robots by parameters of `value` and `std`.
        there: the same on the other device.
        rounded: the same as here, with predictions changed by rounding errors.
    """
    apart = _apart(here, there)
    repeats = np.max([np.zeros(len(apart)), *(_apart(here, fit) for fit in rounded)], axis=0)
    firm = repeats <= STILL
    worst = float(apart[firm].max()) if firm.any() else np.inf
    said = [f"{worst:.2g} standard deviations at most; {STILL:g} allowed"]
    if not firm.all():
        others = ", ".join(f"{d:.2g} ({r:.2g})" for d, r in zip(apart[~firm], repeats[~firm], strict=True))
        said = [f"{said[0]}, of {firm.sum()} of {len(firm)} robots", f"others, and A by rounding alone: {others}"]
    return {
        "what": what,
        "seconds": [fit["seconds"] for fit in (here, there)],
        "answers": [
            f"{fit['distance']:.3g} from the truth" + ", stopped before it settled" * (not fit["converged"])
            for fit in (here, there)
        ],
        "apart": "; ".join(said),
        "standard_deviations": apart.tolist(),
        "by_rounding": repeats.tolist(),
        "same": bool(worst <= STILL),
    }


def _apart(here: dict[str, Any], there: dict[str, Any]) -> NDArray[np.float64]:
    """Of each robot, the most that a value differs, in standard deviations of both fits together."""
    (a, a_std), (b, b_std) = ([np.array(fit[key]) for key in ("value", "std")] for fit in (here, there))
    return np.max(np.abs(a - b) / np.hypot(a_std, b_std), axis=1)


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
