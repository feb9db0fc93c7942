"""Which parameters the recordings determine, and which only together with others, in words."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]

UNIFORM_STD = 1 / np.sqrt(12.0)
"""Standard deviation of the prior, in widths of the bounds."""

TOLD = 0.8
"""Share of the prior's standard deviation above which a parameter counts as not told: a third of a bit was gained."""

TIED = 0.9
"""Correlation from which two parameters are named together: a third of their marginal errors or less is left."""

SIMPLE = 0.25
"""How far a coefficient may be from 1 to be left out of the words."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What one robot's recordings say of its parameters, the bounds included.

    value: best parameters, physical units                                 (D,)
    covariance: of the parameters, physical units                          (D, D)
    """

    space: ParameterSpace
    value: Array
    covariance: Array

    @classmethod
    def of(cls, space: ParameterSpace, z: Array, fisher: Array) -> Knowledge:
        """From the information (D, D) about z at a mode z (D,)."""
        share = expit(z)
        # in widths of the bounds, so that all parameters have the same prior
        slope = np.maximum(share * (1 - share), 1e-12)
        information = fisher / np.outer(slope, slope) + np.eye(len(z)) / UNIFORM_STD**2
        scale = np.sqrt(np.diag(information))
        covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
        width = space.width
        return cls(space, space.to_physical(z), 0.5 * (covariance + covariance.T) * np.outer(width, width))

    @property
    def std(self) -> Array:
        """Standard errors, physical units, (D,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def told(self) -> NDArray[np.bool_]:
        """Whether the recordings say anything of each parameter, (D,)."""
        return self.std < TOLD * UNIFORM_STD * self.space.width

    def words(self, i: int) -> str:
        """How well parameter i is known by itself."""
        if not self.told[i]:
            return "not told by these recordings"
        return f"known to {_precision(self.space, i, self.value[i], self.std[i])}"

    def pairs(self) -> list[dict[str, Any]]:
        """Pairs of which a combination is known much better than either: its words and how much better."""
        std = self.std
        found = []
        for i, j in combinations(range(len(std)), 2):
            correlation = self.covariance[i, j] / (std[i] * std[j])
            if abs(correlation) >= TIED:
                found.append({"parameters": [i, j], **self._pair(i, j), "correlation": float(correlation)})
        return sorted(found, key=lambda row: -abs(row["correlation"]))

    def _pair(self, i: int, j: int) -> dict[str, Any]:
        a, b = self.space[i], self.space[j]
        x, y, c = self.value[i], self.value[j], self.covariance
        factor = -c[i, j] / c[j, j]
        error = np.sqrt(max(c[i, i] - c[i, j] ** 2 / c[j, j], 0.0))
        split = _percent(max(self.std[i] / abs(x), self.std[j] / abs(y))) if x and y else "nothing"
        positive = a.low > 0 and b.low > 0
        if positive and factor < 0 and abs(-factor * y / x - 1) < SIMPLE:
            # in logs the coefficient is one: the ratio
            return {"words": f"{a.name} / {b.name} is known to {_percent(error / x)}, their size only to {split}"}
        same = a.unit == b.unit and abs(abs(factor) - 1) < SIMPLE
        number = "" if same else f"{abs(factor):.2g} "
        sign = "+" if factor > 0 else "-"
        total = x + factor * y
        known = _percent(error / abs(total)) if abs(total) > error else f"{error:.2g} {a.unit}".strip()
        return {"words": f"{a.name} {sign} {number}{b.name} is known to {known}, their split only to {split}"}

    def flattest(self) -> str:
        """The worst direction where it is worse than the bounds' half and spread over three parameters or more."""
        scale = UNIFORM_STD * self.space.width
        values, vectors = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        v = vectors[:, -1]
        members = [int(i) for i in np.argsort(-np.abs(v)) if v[i] ** 2 > 0.1]
        if values[-1] < TOLD**2 or len(members) < 3:
            return ""
        first = np.sign(v[members[0]])
        parts = [f"{self.space[i].name} {'up' if v[i] * first > 0 else 'down'}" for i in members]
        return f"{', '.join(parts[:-1])} and {parts[-1]} together change nothing that these recordings show"


def describe_knowledge(rows: list[Knowledge]) -> dict[str, Any]:
    """All robots in words: each parameter, the pairs tied together, and directions that nothing was said about.

    Returns:
        `parameters`: name to words, the number of robots that tell it, and median relative error; `combinations`:
        words and number of robots, the most frequent first; `blind`: directions of three parameters or more.
    """
    space, total = rows[0].space, len(rows)
    parameters = {}
    for i, p in enumerate(space):
        told = [k for k in rows if k.told[i]]
        if told:
            middle = sorted(told, key=lambda k: float(k.std[i]))[len(told) // 2]
            words = middle.words(i) + (f" in {len(told)} of {total} robots" if len(told) < total else "")
            if len(told) < total:
                words += ", not told by the recordings of the others"
        else:
            words = "not told by these recordings"
        share = float(np.median([k.std[i] for k in rows]) / (UNIFORM_STD * space.width[i]))
        parameters[p.name] = {"words": words, "told": len(told), "robots": total, "left_of_prior": min(share, 1.0)}
    pairs: dict[tuple[int, ...], list[dict[str, Any]]] = {}
    for k in rows:
        for row in k.pairs():
            pairs.setdefault(tuple(row["parameters"]), []).append(row)
    combos = [
        {"words": found[len(found) // 2]["words"], "robots": len(found)}
        for found in sorted(pairs.values(), key=lambda f: -len(f))
        if 2 * len(found) >= total
    ]
    blind = [text for text in dict.fromkeys(k.flattest() for k in rows) if text]
    return {"parameters": parameters, "combinations": combos, "blind": blind[:3]}


def _precision(space: ParameterSpace, i: int, value: float, std: float) -> str:
    if space[i].low > 0 or space[i].high < 0:
        return _percent(std / abs(value))
    return f"{std:.2g} {space[i].unit}".strip()


def _percent(share: float) -> str:
    return "better than 0.001 %" if share < 1e-5 else f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.0f} %"
