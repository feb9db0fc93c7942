"""`nfpde bench ot`: exact optimal transport beside POT, SciPy and other packages that are installed."""

from __future__ import annotations

import json
import platform
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from nfpde.ot import emd

Array = NDArray[np.float64]
Solve = Callable[[Array, Array, Array | None, Array | None], float]

SEED = 0
REPEATS = {300: 15, 2000: 5, 10**9: 3}
"""Repeats of a case with at most so many points; the median is reported."""


@dataclass(frozen=True)
class Case:
    """n points against m in d dimensions; `kind` of the clouds and `weights` of the points."""

    n: int
    m: int
    d: int
    kind: str
    weights: str

    def __str__(self) -> str:
        size = f"n={self.n}" if self.n == self.m else f"{self.n} x {self.m}"
        return f"{self.weights} {size} d={self.d} {self.kind}"


FULL = (
    *(Case(n, n, 6, "gauss", w) for n in (100, 300, 1000) for w in ("uniform", "random")),
    *(Case(1000, 1000, d, kind, "uniform") for d, kind in ((2, "gauss"), (30, "gauss"), (6, "mix"), (6, "lattice"))),
    *(Case(1000, 1000, d, kind, "random") for d, kind in ((2, "gauss"), (30, "gauss"), (6, "mix"), (6, "duplicates"))),
    Case(2000, 10, 6, "gauss", "random"),
    *(Case(5000, 5000, d, "gauss", "uniform") for d in (2, 6, 30)),
    *(Case(5000, 5000, d, "gauss", "random") for d in (2, 6, 30)),
)
QUICK = tuple(case for case in FULL if case.n <= 300 or case.m == 10)


def clouds(case: Case) -> tuple[Array, Array, Array | None, Array | None]:
    """Points (n, d) and (m, d) and their weights; equal weights are None."""
    rng = np.random.default_rng(SEED)
    x, y = rng.normal(size=(case.n, case.d)), 0.5 + 1.2 * rng.normal(size=(case.m, case.d))
    if case.kind == "mix":
        centres, widths = 3 * rng.normal(size=(5, case.d)), 0.5 + rng.random(5)
        shifts = 0.3 * rng.normal(size=(5, case.d))
        i, j = rng.integers(0, 5, case.n), rng.integers(0, 5, case.m)
        x = centres[i] + widths[i, None] * x
        y = centres[j] + shifts[j] + widths[j, None] * rng.normal(size=y.shape)
    elif case.kind == "lattice":
        x, y = np.round(x), np.round(y)
    elif case.kind == "duplicates":
        x, y = x[rng.integers(0, case.n // 10, case.n)], y[rng.integers(0, case.m // 10, case.m)]
    if case.weights == "uniform":
        return x, y, None, None
    a, b = rng.exponential(size=case.n), rng.exponential(size=case.m)
    return x, y, a / a.sum(), b / b.sum()


def solvers(case: Case) -> dict[str, Solve]:
    """This package and its peers for a case, each from points to the cost; peers start from SciPy's distances."""
    found: dict[str, Solve] = {"nfpde": lambda x, y, a, b: emd(x, y, a, b).cost}
    if find_spec("ot") is not None:
        found["POT"] = _pot
    if case.weights == "uniform" and case.n == case.m:
        found["SciPy"] = _scipy
        if find_spec("lapjv") is not None:
            lapjv = import_module("lapjv").lapjv
            found["lapjv"] = lambda x, y, a, b: _assigned(cost := cdist(x, y), lapjv(cost)[0])
    return found


def run(quick: bool, out: Path) -> None:
    """Measure every case with interleaved runs, print a table, write it to ot.md and ot.json.

    Args:
        quick: small cases only.
        out: folder for the tables.
    """
    facts = {
        "command": "nfpde bench ot" + (" --quick" if quick else ""),
        "seed": SEED,
        "versions": {name: version(name) for name in ("nfpde", "numpy", "scipy")} | _peers(),
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
    }
    rows = []
    for case in QUICK if quick else FULL:
        rows.append(_measure(case))
        print(_line(rows[-1]), flush=True)
    out.mkdir(parents=True, exist_ok=True)
    name = "ot_quick" if quick else "ot"
    (out / f"{name}.json").write_text(json.dumps({**facts, "rows": rows}, indent=1))
    table = _table(rows, facts)
    print(table)
    (out / f"{name}.md").write_text(table)


def _measure(case: Case) -> dict[str, Any]:
    """Median CPU seconds of every solver, in turn, and how far their costs are apart."""
    data, candidates = clouds(case), solvers(case)
    repeats = next(count for limit, count in REPEATS.items() if max(case.n, case.m) <= limit)
    times: dict[str, list[float]] = {name: [] for name in candidates}
    costs: dict[str, float] = {}
    for _ in range(repeats):
        for name, solve in candidates.items():
            started = time.process_time()
            costs[name] = solve(*data)
            times[name].append(time.process_time() - started)
    own = costs["nfpde"]
    return {
        "case": str(case),
        **asdict(case),
        "repeats": repeats,
        "seconds": {name: statistics.median(t) for name, t in times.items()},
        "apart": max(abs(c - own) / own for c in costs.values()),
    }


def _pot(x: Array, y: Array, a: Array | None, b: Array | None) -> float:
    """POT with as many iterations as it takes: its default stops early at large sizes and returns a wrong cost."""
    pot = import_module("ot")
    cost = cdist(x, y)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return float(pot.emd2([] if a is None else a, [] if b is None else b, cost, numItermax=10**9))


def _scipy(x: Array, y: Array, a: Array | None, b: Array | None) -> float:
    cost = cdist(x, y)
    rows, columns = linear_sum_assignment(cost)
    return float(cost[rows, columns].mean())


def _assigned(cost: NDArray[Any], columns: NDArray[np.intp]) -> float:
    return float(cost[np.arange(len(cost)), columns].mean())


def _peers() -> dict[str, str]:
    packages = {"ot": "POT", "lapjv": "lapjv"}
    return {package: version(package) for module, package in packages.items() if find_spec(module) is not None}


def _line(row: dict[str, Any]) -> str:
    own = row["seconds"]["nfpde"]
    cells = [
        f"{row['seconds'][peer] / own:.1f}x" if peer in row["seconds"] else "" for peer in ("POT", "SciPy", "lapjv")
    ]
    return f"| {row['case']} | {1e3 * own:.2f} | {' | '.join(cells)} | {row['apart']:.0e} | {row['repeats']} |"


def _table(rows: list[dict[str, Any]], facts: dict[str, Any]) -> str:
    lost = [r["case"] for r in rows if any(t < r["seconds"]["nfpde"] for t in r["seconds"].values())]
    worst = max(r["apart"] for r in rows)
    return "\n".join(
        [
            "# Exact optimal transport",
            "",
            "From points to the exact Euclidean cost, one thread, median CPU time of interleaved runs in one process. "
            "Peers: how many times longer they take, the distance matrix (SciPy's) included; POT with numItermax=1e9, "
            "because its default stops early at large sizes. `apart`: largest relative difference of the costs.",
            "",
            "| case | nfpde, CPU ms | POT | SciPy | lapjv | apart | repeats |",
            "|---|---|---|---|---|---|---|",
            *map(_line, rows),
            "",
            f"Slower than a peer in {len(lost)} of {len(rows)} cases" + (f": {'; '.join(lost)}." if lost else "."),
            f"All costs agree to {worst:.0e}, relative.",
            "",
            f"`{facts['command']}`, seed {facts['seed']}; versions {facts['versions']}; {facts['machine']}.",
            "",
        ]
    )
