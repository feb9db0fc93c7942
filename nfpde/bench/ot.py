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
from functools import partial
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from nfpde.bench.code import built_solver
from nfpde.bench.footprint import footprint
from nfpde.bench.ot_table import line, table
from nfpde.bench.ot_threads import scaling
from nfpde.bench.partial import Partial
from nfpde.bench.peers import PACKAGES, Peers
from nfpde.ot import emd
from nfpde.storage import write_whole

Array = NDArray[np.float64]
Solve = Callable[[Array, Array, Array | None, Array | None], float]

SEED = 0
LAZY = 2000
"""Points up to which POT's solver without a matrix takes part; beyond it takes minutes."""
REPEATS = {300: 15, 2000: 5, 10**9: 3}
"""Repeats of a case with at most so many points; the median is reported."""
WARM = 2000
"""Points up to which every run follows another of the same solver, so that it finds its own data in the caches."""
SLOW = 5.0
"""CPU seconds from which on a peer runs once."""


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
    *(Case(1000, 1000, d, "gauss", w) for d in (2, 30) for w in ("uniform", "random")),
    *(Case(1000, 1000, 6, kind, w) for kind in ("mix", "lattice", "duplicates") for w in ("uniform", "random")),
    Case(1000, 1000, 6, "gauss", "skewed"),
    Case(745, 1376, 6, "five points", "random"),
    Case(2000, 10, 6, "gauss", "random"),
    Case(10, 2000, 6, "gauss", "random"),
    *(Case(5000, 5000, d, "gauss", w) for d in (2, 6, 30) for w in ("uniform", "random")),
    *(Case(5000, 5000, 6, "mix", w) for w in ("uniform", "random")),
)
QUICK = tuple(case for case in FULL if case.n <= 300 or case.m == 10)
LARGE = tuple(Case(20000, 20000, 6, "gauss", w) for w in ("uniform", "random"))
"""Cases without peers: their tables of 3.2 GB, and ten more for POT, are beyond many a machine."""
THREADS = (
    LARGE[0],
    Case(10000, 10000, 30, "gauss", "uniform"),
    Case(5000, 5000, 200, "gauss", "uniform"),
)
"""Cases for several threads, which share the passes over all pairs: more of the work the more coordinates there are."""


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
    elif case.kind == "five points":
        x, y = x[rng.integers(0, 5, case.n)], y[rng.integers(0, 5, case.m)]
    elif case.kind == "duplicates":
        x, y = x[rng.integers(0, case.n // 10, case.n)], y[rng.integers(0, case.m // 10, case.m)]
    if case.weights == "uniform":
        return x, y, None, None
    power = 6 if case.weights == "skewed" else 1
    a, b = rng.exponential(size=case.n) ** power, rng.exponential(size=case.m) ** power
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

    Where it was stopped, the same command goes on.

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
        "solver": built_solver(),
    }
    out.mkdir(parents=True, exist_ok=True)
    name = "ot_quick" if quick else "ot"
    parts, rows = Partial(out / f"{name}.part.json", facts), []
    for case in QUICK if quick else FULL:
        rows.append(parts.get(str(case), partial(_measure, case, peers)))
        print(line(rows[-1]), flush=True)
    if peers:
        peers.close()
    large = [] if quick else [parts.get(str(case), partial(_measure_alone, case)) for case in LARGE]
    threads = [] if quick else [parts.get(f"threads, {case}", partial(_threads, case)) for case in THREADS]
    write_whole(out / f"{name}.json", json.dumps({**facts, "rows": rows, "large": large, "threads": threads}, indent=1))
    page = table(rows, large, threads, facts, (SLOW, WARM))
    print(page)
    write_whole(out / f"{name}.md", page)
    parts.finish()


def _measure(case: Case, peers: Peers | None) -> dict[str, Any]:
    """Median CPU seconds of every solver, in turn, and how far their costs are apart."""
    data, candidates = clouds(case), solvers(case)
    others = _packages(case, peers)
    if peers and others:
        with tempfile.TemporaryDirectory() as folder:
            peers.load(_saved(data, Path(folder), full=True))
    repeats = next(count for limit, count in REPEATS.items() if max(case.n, case.m) <= limit)
    runs: dict[str, Callable[[], tuple[float, float]]] = {
        **{name: partial(_timed, solve, data) for name, solve in candidates.items()},
        **({name: partial(peers.solve, name) for name in others} if peers else {}),
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    costs: dict[str, float] = {}
    for _ in range(repeats):
        for name, solve in runs.items():
            if max(times[name], default=0) > SLOW:
                continue
            if max(case.n, case.m) <= WARM:
                solve()
            seconds, costs[name] = solve()
            times[name].append(seconds)
    own = costs["nfpde"]
    return {
        "case": str(case),
        **asdict(case),
        "repeats": repeats,
        "seconds": {name: statistics.median(t) for name, t in times.items()},
        "apart": max(abs(c - own) / own for c in costs.values()),
    }


def _timed(solve: Solve, data: tuple[Array, Array, Array | None, Array | None]) -> tuple[float, float]:
    """CPU seconds and cost."""
    started = time.process_time()
    cost = solve(*data)
    return time.process_time() - started, cost


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
    fits = [name for name, kind in PACKAGES.items() if (kind == "uniform") == (case.weights == "uniform")]
    return [name for name in fits if name in peers.versions and (case.weights != "uniform" or case.n == case.m)]


def _saved(data: tuple[Array, Array, Array | None, Array | None], folder: Path, *, full: bool) -> Path:
    """A file with the points and weights of a case; equal weights are written out when it is to be `full`."""
    x, y, a, b = data
    weights = {"a": (a, len(x)), "b": (b, len(y))}
    arrays = {name: np.full(n, 1 / n) if w is None else w for name, (w, n) in weights.items() if full or w is not None}
    path = folder / "case.npz"
    np.savez(path, x=x, y=y, **arrays)  # pyright: ignore[reportArgumentType]
    return path


def _measure_alone(case: Case) -> dict[str, Any]:
    """CPU seconds and growth of memory of this package, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        seconds, megabytes = footprint(_saved(clouds(case), Path(folder), full=False))
    return {"case": str(case), **asdict(case), "seconds": seconds, "megabytes": megabytes}


def _threads(case: Case) -> dict[str, Any]:
    """Wall seconds by number of threads."""
    return {"case": str(case), "rows": scaling(*clouds(case))}
