"""Figures over all cases: rates with their intervals, the confusion matrix, accuracy by size."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from statistics import median
from typing import Any

from nfpde.bench.gap.score import Row

BINS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, math.inf)
"""Edges of the sizes over the noise."""

Figure = tuple[str, str, float | None, int, bool | None]
"""Name, target in words, value, number of cases or values behind it, whether the target is met (None: no cases)."""


def rate(rows: Sequence[Row], holds: Callable[[Row], bool]) -> float | None:
    """Share of rows for which something holds; None of none."""
    return sum(map(holds, rows)) / len(rows) if rows else None


def wilson(share: float, n: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a share of n cases (Wilson 1927).

    Example:
        >>> [round(x, 3) for x in wilson(0.5, 100)]
        [0.404, 0.596]
    """
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def of_kind(rows: Sequence[Row], *kinds: str) -> list[Row]:
    """Rows of some kinds of systems."""
    return [row for row in rows if row.kind in kinds]


def faulty(rows: Sequence[Row]) -> bool:
    """Whether any fault is hidden in these systems; there are tables of sound robots alone."""
    return any(row.kind != "none" for row in rows)


def figures(rows: Sequence[Row]) -> list[Figure]:
    """The figures that have targets, in the order of the table."""
    one, none, two, out = (of_kind(rows, kind) for kind in ("one", "none", "two", "outsider"))
    errors = [e for row in of_kind(rows, "one", "two") for e in row.errors.values()]
    after = [row.after for row in rows if row.kind != "outsider" and row.after is not None]
    found: list[Figure] = []

    def least(name: str, some: Sequence[Row], holds: Callable[[Row], bool], target: float) -> None:
        value = rate(some, holds)
        found.append((name, f">= {100 * target:g} %", value, len(some), None if value is None else value >= target))

    def middle(name: str, values: Sequence[float], target: float, words: str) -> None:
        value = median(values) if values else None
        found.append((name, words, value, len(values), None if value is None else value <= target))

    least("right cause, one effect", one, lambda r: r.cause, 0.95)
    least("right place, one effect", one, lambda r: r.place, 0.98)
    alarms = rate(none, lambda r: not r.right)
    found.append(("alarms on controls", "<= 2 %", alarms, len(none), None if alarms is None else alarms <= 0.02))
    least("outsiders called unexplained", out, lambda r: r.right, 0.90)
    least("pairs, both found", two, lambda r: r.right, 0.80)
    middle("relative error of fitted values, median", errors, 0.05, "<= 5 %")
    middle("gap after over what the true robot leaves, median", after, 1.2, "<= 1.2")
    own = [row.own_after for row in rows if row.kind != "outsider" and row.own_after is not None]
    middle("gap after over the floor that the diagnosis states, median", own, 1.2, "<= 1.2")
    middle("seconds, median", [row.seconds for row in rows], 60, "<= 60")
    return found


def coverage(rows: Sequence[Row]) -> list[tuple[str, float | None, int]]:
    """How often the stated 95 % intervals hold the true value: of effects' values, and of free parameters."""
    return [
        (name, sum(held) / len(held) if held else None, len(held))
        for name, held in (
            ("values of effects", [x for row in rows for x in row.inside.values()]),
            ("free parameters, where the case is right", [x for row in rows for x in row.base_inside.values()]),
        )
    ]


def at_floor(rows: Sequence[Row]) -> float | None:
    """Share of the cases without outsiders whose gap is at most 1.2 noise floors in the end."""
    mine = [row for row in rows if row.kind != "outsider"]
    return rate(mine, lambda r: r.after is not None and r.after <= 1.2)


def by_size(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Accuracy by size over the noise: of single effects, of outsiders, and of pairs by the lesser of their two."""
    found = []
    for low, high in pairwise(BINS):
        some = [row for row in rows if row.sizes and low <= min(row.sizes) < high]
        one, two, out = (of_kind(some, kind) for kind in ("one", "two", "outsider"))
        found.append(
            {
                "low": low,
                "high": None if math.isinf(high) else high,
                "cases": len(one),
                "cause": rate(one, lambda r: r.cause),
                "place": rate(one, lambda r: r.place),
                "value_error": _middle([e for row in one for e in row.errors.values()]),
                "pairs": len(two),
                "both": rate(two, lambda r: r.right),
                "outsiders": len(out),
                "unexplained": rate(out, lambda r: r.right),
            }
        )
    return found


def by_effect(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Accuracy of single effects by effect, and of outsiders by outsider."""
    found = []
    for kind in ("one", "outsider"):
        some = of_kind(rows, kind)
        for effect in sorted({name_of(row.truth[0]) for row in some}):
            mine = [row for row in some if name_of(row.truth[0]) == effect]
            found.append(
                {
                    "effect": effect,
                    "kind": kind,
                    "cases": len(mine),
                    "cause": rate(mine, lambda r: r.cause if r.kind == "one" else r.right),
                    "alone": rate(mine, lambda r: r.alone) if kind == "one" else None,
                    "place": rate(mine, lambda r: r.place),
                    "value_error": _middle([e for row in mine for e in row.errors.values()]),
                    "size": _middle([row.sizes[0] for row in mine]),
                    "set_size": sum(row.set_size for row in mine) / len(mine),
                }
            )
    return found


def by_robot(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Right cases by robot."""
    found = []
    for robot in sorted({row.robot for row in rows}):
        mine = [row for row in rows if row.robot == robot]
        seconds = _middle([row.seconds for row in mine])
        found.append({"robot": robot, "cases": len(mine), "right": rate(mine, lambda r: r.right), "seconds": seconds})
    return found


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Hidden effect (or "none") to what was named first: the effect itself where its set held it."""
    counts: dict[str, Counter[str]] = {}
    for row in of_kind(rows, "one", "none", "outsider"):
        truth = name_of(row.truth[0]) if row.truth else "none"
        named = truth if row.cause else name_of(row.named[0]) if row.named else row.verdict or "failed"
        counts.setdefault(truth, Counter())[named] += 1
    return {truth: dict(counts[truth].most_common()) for truth in sorted(counts)}


def name_of(described: str) -> str:
    """The effect of an "effect @ target"."""
    return described.partition(" @ ")[0]


def _middle(values: Sequence[float]) -> float | None:
    return median(values) if values else None
