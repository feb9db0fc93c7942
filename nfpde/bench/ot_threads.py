"""How the passes over all pairs scale with threads: wall time of one solve, in turn with each number of them."""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.ot import emd
from nfpde.sim.cores import usable_cores

Array = NDArray[np.float64]

REPEATS = 3


def scaling(x: Array, y: Array, a: Array | None, b: Array | None) -> list[dict[str, Any]]:
    """Median wall seconds by number of threads (1, 2, 4, ... up to the cores), and whether all costs are the same bits.

    Args:
        x: points (n, d).
        y: points (m, d).
        a: weights of x (n,), or None.
        b: weights of y (m,), or None.
    """
    cores = usable_cores()
    counts = [2**k for k in range(cores.bit_length()) if 2**k <= cores]
    seconds: dict[int, list[float]] = {threads: [] for threads in counts}
    costs: set[float] = set()
    for _ in range(REPEATS):
        for threads, times in seconds.items():
            started = time.perf_counter()
            costs.add(emd(x, y, a, b, threads=threads).cost)
            times.append(time.perf_counter() - started)
    return [
        {"threads": threads, "seconds": statistics.median(times), "same_bits": len(costs) == 1}
        for threads, times in seconds.items()
    ]
