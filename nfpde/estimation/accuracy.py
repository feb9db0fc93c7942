"""Errors of the robots' best values beside their Cramer-Rao bounds, where the true parameters are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from nfpde.truth import Truth

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Accuracy:
    """How far the best values are from the truth, and how far those of any unbiased estimator must be.

    Args:
        names: Of the parameters.
        units: Of the parameters.
        robots: Names of the G robots that the fit found and whose true parameters are known.
        error: Best values less true ones, (G, D), in physical units.
        bound: Square roots of the Cramer-Rao bounds, (G, D), in physical units; infinite where a robot's own recordings
            do not determine a parameter.
    """

    names: Sequence[str]
    units: Sequence[str]
    robots: Sequence[str]
    error: Array
    bound: Array

    def to_json(self) -> dict[str, Any]:
        """Each robot's errors and bounds by parameter, as plain JSON values; infinite bounds are null."""
        return {
            robot: {
                name: {"error": float(e), "cramer_rao": float(b) if np.isfinite(b) else None}
                for name, e, b in zip(self.names, error, bound, strict=True)
            }
            for robot, error, bound in zip(self.robots, self.error, self.bound, strict=True)
        }

    def __rich__(self) -> Table:
        """Root mean squares over the robots, for a terminal."""
        table = Table(title=f"Best values of {len(self.robots)} robots, root mean square", box=SIMPLE_HEAD)
        for head in ("parameter", "unit"):
            table.add_column(head, no_wrap=True)
        for head in ("error", "Cramer-Rao", "ratio", "told by"):
            table.add_column(head, justify="right", no_wrap=True)
        for name, unit, error, bound in zip(self.names, self.units, self.error.T, self.bound.T, strict=True):
            told = np.isfinite(bound)
            row = ["none", ""]
            if told.any():
                row = [f"{_rms(bound[told]):.3g}", f"{_rms(error[told] / bound[told]):.2f}"]
            table.add_row(escape(name), escape(unit), f"{_rms(error):.3g}", *row, f"{told.sum()} of {len(told)}")
        return table


def accuracy(robots: Sequence[Mapping[str, Any]], truth: Truth) -> Accuracy | None:
    """Compare what `fit` found of each robot with the truth.

    Args:
        robots: `FitResult.info["robots"]` of a fit by `trajectory`.
        truth: true parameters of the recorded episodes.

    Returns:
        Of the robots that have an episode in the truth, which has the same parameters for all of theirs; None where
        there is no such robot, as in results that do not name episodes.
    """
    of_episode = dict(zip(truth.episodes, truth.xi, strict=True))
    known, true = [], []
    for row in robots:
        own = np.array([of_episode[e] for e in row.get("episodes", ()) if e in of_episode])
        if len(own) and (own == own[0]).all():
            known.append(row)
            true.append(own[0])
    if not known:
        return None
    names = list(truth.space.names)
    value, bound = (
        np.array([[np.inf if (x := row["parameters"][n][key]) is None else x for n in names] for row in known])
        for key in ("value", "cramer_rao")
    )
    units = [p.unit for p in truth.space]
    return Accuracy(names, units, [row["robot"] for row in known], value - np.array(true), bound)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
