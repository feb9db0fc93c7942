"""Which parameters the recordings determine, and which only together with others, in words."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from nfpde.estimation.trajectory.information import inverse
from nfpde.estimation.trajectory.modes import LocalPosterior
from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]

UNIFORM_STD = 1 / np.sqrt(12.0)
"""Standard deviation of the prior, in widths of the bounds."""

TOLD = 0.8
"""Share of the prior's standard deviation above which a parameter counts as not told: a third of a bit was gained."""

TIED = 0.9
"""Correlation from which two parameters are named together: a third of their marginal errors or less is left."""

LIKELY = 0.05
"""Weight from which a mode is one that the recordings may mean: what a 90 % interval has to hold."""

TWO = 3.0
"""Standard errors between the values of two modes from which they are two values, not one that is known less well."""

SIMPLE = 0.25
"""How far a coefficient may be from 1 to be left out of the words."""

PLAIN = 2.0
"""Times the error of the sharpest combination that one in plain words may have: with coefficients rounded, or none."""

DIGITS = range(2, 9)
"""Significant digits of a coefficient: as few as leave what the words say that well known."""

FINEST = 1e-5
"""Share of a value below which the words give no figure."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What one robot's recordings say of its parameters, the bounds included.

    value: best parameters, physical units                                 (D,)
    covariance: of the parameters, over all likely modes, physical units   (D, D)
    values: of every likely mode, the best first, physical units           (K, D)
    errors: standard errors of the parameters in each of them              (K, D)
    """

    space: ParameterSpace
    value: Array
    covariance: Array
    values: Array
    errors: Array

    @classmethod
    def of(cls, space: ParameterSpace, posterior: LocalPosterior) -> Knowledge:
        """From a robot's modes and the information about z at each of them."""
        likely = posterior.weights >= LIKELY
        likely[0] = True
        weights = posterior.weights[likely] / posterior.weights[likely].sum()
        share = expit(posterior.means[likely])
        # in widths of the bounds, so that all parameters have the same prior
        slope = np.maximum(share * (1 - share), 1e-12)
        prior = np.eye(len(space)) / UNIFORM_STD**2
        own = inverse(posterior.fisher[likely] / (slope[:, :, None] * slope[:, None]) + prior)
        values = space.to_physical(posterior.means[likely])
        off = (values - weights @ values) / space.width
        total = np.einsum("k,kij->ij", weights, own + off[:, :, None] * off[:, None])
        errors = np.sqrt(np.einsum("kii->ki", own)) * space.width
        return cls(space, values[0], total * np.outer(space.width, space.width), values, errors)

    @property
    def std(self) -> Array:
        """Standard errors, physical units, (D,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlations(self) -> Array:
        """Of the errors of every two parameters, (D, D)."""
        return self.covariance / np.outer(self.std, self.std)

    @property
    def told(self) -> NDArray[np.bool_]:
        """Whether the recordings say anything of each parameter, (D,)."""
        return self.std < TOLD * UNIFORM_STD * self.space.width

    def words(self, i: int) -> str:
        """How well parameter i is known by itself."""
        several = self._several(i)
        if several:
            return several
        if not self.told[i]:
            return "not told by these recordings"
        return f"known to {_precision(self.space, i, self.value[i], self.std[i])}"

    def tells(self, i: int) -> bool:
        """Whether the recordings say anything of parameter i: one value, or several of which each is told."""
        return bool(self.told[i] or self._several(i))

    def _several(self, i: int) -> str:
        """The values of parameter i that the recordings leave, where these are several, each of them told; else ""."""
        order = np.argsort(self.values[:, i], kind="stable")
        values, errors = self.values[order, i], self.errors[order, i]
        apart = np.diff(values) > TWO * np.hypot(errors[1:], errors[:-1])
        if not apart.any() or (errors >= TOLD * UNIFORM_STD * self.space.width[i]).any():
            return ""
        groups = np.split(np.arange(len(values)), np.flatnonzero(apart) + 1)
        shown = " or ".join(f"{values[g].mean():.3g}" for g in groups)
        worst = int(errors.argmax())
        return f"{shown}, each known to {_precision(self.space, i, values[worst], errors[worst])}"

    def pairs(self) -> list[dict[str, Any]]:
        """Pairs of which a combination is known much better than either: its words and how much better."""
        correlations, found = self.correlations, []
        for i, j in combinations(range(len(correlations)), 2):
            if abs(correlations[i, j]) >= TIED:
                found.append({"parameters": [i, j], **self._pair(i, j), "correlation": float(correlations[i, j])})
        return sorted(found, key=lambda row: -abs(row["correlation"]))

    def _pair(self, i: int, j: int) -> dict[str, Any]:
        a, b = self.space[i], self.space[j]
        x, y, c = self.value[i], self.value[j], self.covariance
        factor = -c[i, j] / c[j, j]
        split = _percent(max(self.std[i] / abs(x), self.std[j] / abs(y)) if x and y else np.inf)
        both = np.array([i, j])
        positive = a.low > 0 and b.low > 0
        if positive and factor < 0 and abs(-factor * y / x - 1) < SIMPLE:
            # in logs the coefficient is one: the ratio
            error = self._error(both, np.array([1 / x, -1 / y]))
            if error <= max(PLAIN * self._error(both, np.array([1.0, factor])) / x, FINEST):
                return {"words": f"{a.name} / {b.name} is known to {_percent(error)}, their size only to {split}"}
        return {"words": f"{self._combination(both, np.array([1.0, factor]))}, their split only to {split}"}

    def _combination(self, members: NDArray[np.intp], v: Array) -> str:
        """How well the combination v (k,) of parameters is known, v[0] = 1: in plain words where these say as much."""
        most = max(PLAIN * self._error(members, v), FINEST * abs(float(v @ self.value[members])))
        units = {self.space[i].unit for i in members}
        shown, texts = np.sign(v), [""] * len(v)
        if len(units) > 1 or (np.abs(np.abs(v) - 1) >= SIMPLE).any() or self._error(members, shown) > most:
            for digits in DIGITS:
                texts = ["", *(f"{abs(f):.{digits}g} " for f in v[1:])]
                shown = np.sign(v) * np.array([1.0, *map(float, texts[1:])])
                if self._error(members, shown) <= most:
                    break
        names = [text + self.space[i].name for i, text in zip(members, texts, strict=True)]
        words = names[0] + "".join(f" {'+' if f > 0 else '-'} {t}" for f, t in zip(v[1:], names[1:], strict=True))
        error, total = self._error(members, shown), abs(float(shown @ self.value[members]))
        known = _percent(error / total) if total > error else f"{_figure(error)} {self.space[members[0]].unit}".strip()
        return f"{words} is known to {known}"

    def _error(self, members: NDArray[np.intp], v: Array) -> float:
        """Standard error of the combination v (k,) of parameters."""
        return float(np.sqrt(max(v @ self.covariance[np.ix_(members, members)] @ v, 0.0)))

    def group(self) -> str:
        """The combination of three parameters or more that is known much better than each of them; "" for none.

        Members are the parameters whose error would fall to less than half if the others were known; the combination
        is the sharpest direction among them, counted in widths of the bounds.
        """
        scale = self.space.width
        covariance = self.covariance / np.outer(scale, scale)
        members = np.flatnonzero(np.diag(covariance) * np.diag(inverse(covariance)) > 1 / (1 - TIED**2))
        if len(members) < 3:
            return ""
        v = np.linalg.eigh(covariance[np.ix_(members, members)])[1][:, 0]
        taking = v**2 > 0.1
        members, v = members[taking], v[taking] / scale[members[taking]]
        if len(members) < 3:
            return ""
        worst = max(float(self.std[i] / abs(self.value[i])) if self.value[i] else np.inf for i in members)
        return f"{self._combination(members, v / v[0])}, their split only to {_percent(worst)}"


def describe_knowledge(rows: list[Knowledge]) -> dict[str, Any]:
    """All robots in words: each parameter, and those that are known only together.

    Returns:
        `parameters`: name to words, the number of robots that tell it, and what is left of the bounds' standard
        deviation in the median robot; `combinations`: words and number of robots, of those that half of them share.
    """
    space, total = rows[0].space, len(rows)
    parameters = {}
    for i, p in enumerate(space):
        told = [k for k in rows if k.tells(i)]
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
    groups = [k.group() for k in rows]
    found = [text for text in groups if text]
    if 2 * len(found) >= total:
        combos.append({"words": found[len(found) // 2], "robots": len(found)})
    return {"parameters": parameters, "combinations": combos}


def _precision(space: ParameterSpace, i: int, value: float, std: float) -> str:
    if space[i].low > 0 or space[i].high < 0:
        return _percent(std / abs(value))
    return f"{_figure(std)} {space[i].unit}".strip()


def _percent(share: float) -> str:
    if not np.isfinite(share):
        return "nothing"
    return "better than 0.001 %" if share < FINEST else f"{_figure(100 * share)} %"


def _figure(value: float) -> str:
    """Two digits that count; from 100 up a whole number, as two digits would come with a power of ten."""
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"
