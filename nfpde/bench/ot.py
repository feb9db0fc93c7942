"""`nfpde bench ot`: exact optimal transport beside POT, SciPy and other packages that are installed."""

from __future__ import annotations

import json
import platform
import statistics
import tempfile
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

from nfpde.bench.peers import PACKAGES, Peers
from nfpde.ot import emd

Array = NDArray[np.float64]
Solve = Callable[[Array, Array, Array | None, Array | None], float]

SEED = 0
LAZY = 2000
"""Points up to which POT's solver without a matrix takes part; beyond it takes minutes."""
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
        if max(case.n, case.m) <= LAZY and hasattr(import_module("ot").lp, "emd2_lazy"):
            found["POT lazy"] = _pot_lazy
    if case.weights == "uniform" and case.n == case.m:
        found["SciPy"] = _scipy
    return found


def run(quick: bool, out: Path, peers_python: Path | None = None) -> None:
    """Measure every case with interleaved runs, print a table, write it to ot.md and ot.json.

    Args:
        quick: small cases only.
        out: folder for the tables.
        peers_python: Python with the packages of `nfpde.bench.peers`; without it they are left out.
    """
    peers = None if peers_python is None else Peers(peers_python)
    command = "nfpde bench ot" + (" --quick" if quick else "")
    facts = {
        "command": command + (" --peers-python ..." if peers else ""),
        "seed": SEED,
        "versions": {name: version(name) for name in ("nfpde", "numpy", "scipy")}
        | ({"POT": version("POT")} if find_spec("ot") is not None else {})
        | (peers.versions if peers else {}),
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
    }
    rows = []
    for case in QUICK if quick else FULL:
        rows.append(_measure(case, peers))
        print(_line(rows[-1]), flush=True)
    if peers:
        peers.close()
    out.mkdir(parents=True, exist_ok=True)
    name = "ot_quick" if quick else "ot"
    (out / f"{name}.json").write_text(json.dumps({**facts, "rows": rows}, indent=1))
    table = _table(rows, facts)
    print(table)
    (out / f"{name}.md").write_text(table)


def _measure(case: Case, peers: Peers | None) -> dict[str, Any]:
    """Median CPU seconds of every solver, in turn, and how far their costs are apart."""
    data, candidates = clouds(case), solvers(case)
    others = _packages(case, peers)
    if peers and others:
        _hand_over(data, peers)
    repeats = next(count for limit, count in REPEATS.items() if max(case.n, case.m) <= limit)
    times: dict[str, list[float]] = {name: [] for name in candidates}
    costs: dict[str, float] = {}
    for _ in range(repeats):
        for name, solve in candidates.items():
            started = time.process_time()
            costs[name] = solve(*data)
            times[name].append(time.process_time() - started)
        if peers:
            for name in others:
                seconds, costs[name] = peers.solve(name)
                times.setdefault(name, []).append(seconds)
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


def _pot_lazy(x: Array, y: Array, a: Array | None, b: Array | None) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solved = import_module("ot").lp.emd2_lazy(x, y, a, b, metric="euclidean", numItermax=10**9, return_matrix=False)
    return float(solved)


def _scipy(x: Array, y: Array, a: Array | None, b: Array | None) -> float:
    cost = cdist(x, y)
    rows, columns = linear_sum_assignment(cost)
    return float(cost[rows, columns].mean())


def _packages(case: Case, peers: Peers | None) -> list[str]:
    """The packages of the other environment that a case compares; assignments have equal sides."""
    if peers is None:
        return []
    fits = [name for name, weights in PACKAGES.items() if weights == case.weights]
    return [name for name in fits if name in peers.versions and (case.weights == "random" or case.n == case.m)]


def _hand_over(data: tuple[Array, Array, Array | None, Array | None], peers: Peers) -> None:
    x, y, a, b = data
    a = np.full(len(x), 1 / len(x)) if a is None else a
    b = np.full(len(y), 1 / len(y)) if b is None else b
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.npz"
        np.savez(path, x=x, y=y, a=a, b=b)
        peers.load(path)


COLUMNS = ("POT", "POT lazy", "SciPy", *PACKAGES)


def _line(row: dict[str, Any]) -> str:
    own = row["seconds"]["nfpde"]
    cells = [f"{row['seconds'][peer] / own:.1f}x" if peer in row["seconds"] else "" for peer in COLUMNS]
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
            "because its default stops early at large sizes; "
            "lapjv, lapx (lapjvr) and Wasserstein in a process of their own, in turn with the others. "
            "`apart`: largest relative difference of the costs.",
            "",
            f"| case | nfpde, CPU ms | {' | '.join(COLUMNS)} | apart | repeats |",
            "|---" * (len(COLUMNS) + 4) + "|",
            *map(_line, rows),
            "",
            f"Slower than a peer in {len(lost)} of {len(rows)} cases" + (f": {'; '.join(lost)}." if lost else "."),
            f"All costs agree to {worst:.0e}, relative.",
            "",
            f"`{facts['command']}`, seed {facts['seed']}; versions {facts['versions']}; {facts['machine']}.",
            "",
        ]
    )
