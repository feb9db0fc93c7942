"""What is wanted of exact transport beside its peers, and whether a measurement shows it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

Row = dict[str, Any]

LAP = ("lapjv", "lapx", "SciPy")
"""Packages that solve assignments."""


@dataclass(frozen=True)
class Want:
    """A peer takes so many times longer in all cases of a kind."""

    what: str
    chosen: Callable[[Row], bool]
    peers: tuple[str, ...]
    least: float


def _square(row: Row, n: int, weights: str) -> bool:
    return bool(row["n"] == row["m"] == n and row["d"] > 2 and row["weights"] == weights)


WANTED = (
    Want("uniform n=5000", lambda r: _square(r, 5000, "uniform"), ("POT",), 8),
    Want("uniform n=5000", lambda r: _square(r, 5000, "uniform"), ("SciPy",), 10),
    Want("uniform n=5000", lambda r: _square(r, 5000, "uniform"), ("lapjv",), 2),
    Want("uniform n=1000", lambda r: _square(r, 1000, "uniform"), ("POT",), 5),
    Want("uniform n=1000", lambda r: _square(r, 1000, "uniform"), ("SciPy",), 3),
    Want("uniform n=1000", lambda r: _square(r, 1000, "uniform"), ("lapjv", "lapx"), 1.2),
    Want("weighted n=5000", lambda r: _square(r, 5000, "random"), ("POT",), 5),
    Want("weighted n=5000", lambda r: _square(r, 5000, "random"), ("Wasserstein",), 4),
    Want("weighted n=1000", lambda r: _square(r, 1000, "random"), ("POT",), 3),
    Want("weighted n=1000", lambda r: _square(r, 1000, "random"), ("Wasserstein",), 2),
    Want("2000 x 10", lambda r: min(r["n"], r["m"]) == 10, ("POT",), 5),
    Want("uniform n=100, 300", lambda r: r["n"] <= 300 and r["weights"] == "uniform", LAP, 1),
    Want("weighted n=100, 300", lambda r: r["n"] <= 300 and r["weights"] == "random", ("POT",), 2),
    Want("d=2", lambda r: r["d"] == 2, ("POT",), 2),
    Want("every case", lambda r: True, ("POT", "SciPy"), 1),
)

SECONDS, MEGABYTES = {"uniform": 12.0, "random": 50.0}, 100.0
"""Most CPU seconds of 20,000 points by their weights, and most growth of memory."""


def verdicts(rows: Sequence[Row], large: Sequence[Row]) -> list[str]:
    """Lines of a table: what is wanted, the least that was measured and in which case, pass or FAIL."""
    lines = []
    for want in WANTED:
        found = [
            (row["seconds"][peer] / row["seconds"]["nfpde"], f"{peer}, {row['case']}")
            for row in rows
            if want.chosen(row)
            for peer in want.peers
            if peer in row["seconds"]
        ]
        if found:
            least, where = min(found)
            passed = "pass" if least >= want.least else "FAIL"
            peers = " and ".join(want.peers)
            lines.append(f"| {want.what} | {want.least:g}x {peers} | {least:.2f}x ({where}) | {passed} |")
    for row in large:
        most, memory = SECONDS[row["weights"]], row["megabytes"]
        verdict = "pass" if math.isfinite(memory) else "not measured"
        if row["seconds"] > most or memory > MEGABYTES:
            verdict = "FAIL"
        measured = f"{row['seconds']:.1f} s, {grown(memory)}"
        lines.append(f"| {row['case']} | {most:g} s, {MEGABYTES:g} MB | {measured} | {verdict} |")
    return lines


def grown(megabytes: float) -> str:
    """Growth of memory; a machine that does not tell it gives NaN."""
    return f"{megabytes:.0f} MB" if math.isfinite(megabytes) else "not measured"
