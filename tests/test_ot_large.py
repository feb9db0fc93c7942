"""nfpde.ot where tables do not fit: methods for large sets, memory, threads, interruption, and random small inputs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import ot as pot
import pytest
from scipy.optimize import linear_sum_assignment

from nfpde.errors import BadInput
from nfpde.ot import emd, emd_matrix, wasserstein
from tests.ot_cases import check_certificate, clouds, distances, masses

#: Two exact solvers differ by rounding only.
SAME = 1e-12


@pytest.mark.parametrize("kind", ["gauss", "mix", "lattice", "duplicates", "far"])
@pytest.mark.parametrize(("n", "m", "d"), [(1201, 1201, 3), (900, 1500, 2), (1150, 1151, 12)])
def test_weighted_sets_beyond_the_table(kind, n, m, d):
    """Short lists of arcs with passes over all pairs give POT's cost and a certificate."""
    x, y = clouds(kind, n, m, d)
    a, b = masses("random", n, m)
    cost = distances(x, y)
    result = emd(x, y, a, b)
    check_certificate(result, cost, a, b)
    assert result.cost == pytest.approx(pot.emd2(a, b, cost, numItermax=10**9), rel=SAME)


@pytest.mark.parametrize("kind", ["gauss", "mix", "lattice", "duplicates", "far"])
@pytest.mark.parametrize(("n", "d"), [(1201, 2), (1300, 6)])
def test_assignments_beyond_the_table(kind, n, d):
    """Augmenting paths on short lists of arcs give SciPy's cost and a certificate."""
    x, y = clouds(kind, n, n, d)
    cost = distances(x, y)
    result = emd(x, y)
    check_certificate(result, cost, *masses("uniform", n, n))
    assert result.cost == pytest.approx(cost[linear_sum_assignment(cost)].mean(), rel=SAME)


@pytest.mark.parametrize("weights", ["uniform", "random", "skewed"])
@pytest.mark.parametrize(("n", "m"), [(2000, 10), (7, 1500), (300, 2), (150, 32)])
@pytest.mark.parametrize("kind", ["gauss", "lattice"])
def test_few_points_against_many(kind, n, m, weights):
    """A few points against many, either way round."""
    x, y = clouds(kind, n, m, 3)
    a, b = masses(weights, n, m)
    cost = distances(x, y)
    result = emd(x, y, a, b)
    check_certificate(result, cost, a, b)
    assert result.cost == pytest.approx(pot.emd2(a, b, cost, numItermax=10**9), rel=SAME)


@pytest.mark.parametrize("spread", [0.0, 1e-9, 1e-6, 1e-2])
@pytest.mark.parametrize("d", [2, 6, 13])
def test_clusters_around_few_points(spread, d):
    """Samples packed around the points they are compared with: steps that cost the same do not go round in circles."""
    for seed in range(25):
        rng = np.random.default_rng(seed)
        centers = rng.uniform(size=(10, d))
        own = rng.permutation(np.repeat(np.arange(10), 200))
        x = centers[own] + spread * rng.normal(size=(2000, d))
        a, b = masses("uniform", 2000, 10)
        cost = distances(x, centers)
        result = emd(x, centers)
        check_certificate(result, cost, a, b)
        assert result.cost <= cost[np.arange(2000), own].mean() + 1e-12


@pytest.mark.parametrize("weights", ["uniform", "random"])
@pytest.mark.parametrize(("n", "m", "distinct"), [(745, 1376, 5), (60, 60, 7), (61, 50, 40), (1300, 1200, 300)])
def test_repeated_points(n, m, distinct, weights):
    """Points given many times: the plan goes to each of them, the potentials prove it over all of them."""
    rng = np.random.default_rng(n)
    x, y = rng.normal(size=(distinct, 6)), rng.normal(size=(distinct, 6))
    x, y = x[rng.integers(0, distinct, n)], y[rng.integers(0, distinct, m)]
    a, b = masses(weights, n, m)
    a, b = (a, b) if weights == "random" else (None, None)
    result = emd(x, y, a, b)
    a, b = masses(weights, n, m)
    cost = distances(x, y)
    check_certificate(result, cost, a, b)
    assert result.cost == pytest.approx(pot.emd2(a, b, cost, numItermax=10**9), rel=SAME)


def test_repeated_points_without_mass():
    """Copies of a point of which some have no mass."""
    x, y = clouds("mix", 8, 9, 2)
    a, b = masses("random", 8, 9)
    once = emd(x, y, a, b)
    zeros = np.zeros(8)
    again = emd(
        np.vstack([x, x, x]), np.vstack([y, y]), np.concatenate([zeros, a, zeros]), np.concatenate([b / 2, b / 2])
    )
    assert again.cost == pytest.approx(once.cost, rel=SAME)
    full = again.plan.toarray()
    assert not full[:8].any()
    assert not full[16:].any()
    np.testing.assert_array_equal(again.potentials[0][:8], again.potentials[0][8:16])


def test_skewed_weights_beyond_the_table():
    """Weights over many decades, some of them zero."""
    x, y = clouds("mix", 1200, 1100, 4)
    a, b = masses("skewed", 1200, 1100)
    a[::3], b[::5] = 0, 0
    a, b = a / a.sum(), b / b.sum()
    cost = distances(x, y)
    result = emd(x, y, a, b)
    check_certificate(result, cost, a, b)
    assert result.cost == pytest.approx(pot.emd2(a, b, cost, numItermax=10**9), rel=SAME)


@pytest.mark.parametrize("seed", range(4))
def test_costs_of_both_signs_with_a_heavy_row_that_differs(seed):
    """One plus every cost is one plus the optimum: negated cosines, one heavy row that points the other way."""
    rng = np.random.default_rng(seed)
    n = 1000
    x, y = rng.normal(size=(n, 4)) + 2, rng.normal(size=(n, 4)) + 1
    a, b = rng.exponential(size=n), rng.exponential(size=n)
    heavy = rng.integers(n)
    x[heavy], a[heavy] = -x.mean(axis=0), a.sum()
    a, b = a / a.sum(), b / b.sum()
    x, y = (points / np.linalg.norm(points, axis=1, keepdims=True) for points in (x, y))
    cost = -x @ y.T
    result = emd_matrix(cost, a, b)
    check_certificate(result, cost, a, b)
    assert result.cost == pytest.approx(emd_matrix(cost + 1, a, b).cost - 1, rel=SAME, abs=SAME)
    assert result.cost == pytest.approx(pot.emd2(a, b, cost, numItermax=10**9), rel=SAME)


def test_large_matrix_without_structure():
    """Random costs have no geometry to lean on."""
    rng = np.random.default_rng(0)
    cost = rng.normal(size=(1200, 1250))
    a, b = masses("random", 1200, 1250)
    result = emd_matrix(cost, a, b)
    check_certificate(result, cost, a, b)
    assert result.cost == pytest.approx(pot.emd2(a, b, cost, numItermax=10**9), rel=SAME)


@pytest.mark.parametrize("weights", ["uniform", "random"])
def test_threads_do_not_change_a_bit(weights):
    """One, two and three threads give the same bits."""
    x, y = clouds("mix", 1200, 1200, 5)
    a, b = masses(weights, 1200, 1200)
    one = emd(x, y, a, b)
    for threads in (2, 3):
        other = emd(x, y, a, b, threads=threads)
        assert other.cost == one.cost
        assert np.array_equal(other.plan.cols, one.plan.cols)
        assert np.array_equal(other.potentials[0], one.potentials[0])


def test_random_small_inputs():
    """A few thousand small problems of every kind: POT's cost, or a refusal where one is due."""
    rng = np.random.default_rng(12)
    for trial in range(3000):
        n, m, d = rng.integers(1, 9, 3)
        x, y = rng.normal(size=(n, d)), rng.normal(size=(m, d))
        if trial % 3 == 0:
            x, y = np.round(x), np.round(y)
        a, b = rng.integers(0, 3, n).astype(float), rng.integers(0, 3, m) + rng.random(m) * (trial % 2)
        if trial % 5 == 0:
            x = x * 10.0 ** rng.integers(-8, 9)
        if not a.any() or not b.any():
            with pytest.raises(BadInput, match="has no mass"):
                emd(x, y, a, b)
            continue
        a, b = a / a.sum(), b / b.sum()
        metric = ("euclidean", "sqeuclidean", "cityblock")[trial % 3]
        cost = distances(x, y, metric)
        expected = pot.emd2(a, b, cost / cost.max(), numItermax=10**9) * cost.max() if cost.max() > 0 else 0.0
        result = emd(x, y, a, b, metric)
        assert result.cost == pytest.approx(expected, rel=1e-11, abs=1e-13 * cost.max()), (trial, n, m, d)
        check_certificate(result, cost, a, b)
        if trial % 7 == 0:
            bad = x.copy()
            bad[rng.integers(n), rng.integers(d)] = rng.choice([np.nan, np.inf, -np.inf])
            with pytest.raises(BadInput, match="must be finite"):
                wasserstein(bad, y, 2, a, b)


@pytest.mark.parametrize("threads", [1, 2])
def test_interruption(threads):
    """Ctrl-C ends a long search, also within a pass over all pairs, and leaves the interpreter usable.

    A pass over these clouds takes seconds, and the first ones only compare points; the search asks twenty times a pass.
    """
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(20000, 300)), rng.normal(size=(20000, 300))
    a, b = masses("random", 20000, 20000)
    # a shell that started the tests in the background may have told its children to ignore interrupts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    start = time.process_time()
    with pytest.raises(KeyboardInterrupt):
        emd(x, y, a, b, threads=threads)
    assert time.process_time() - start < 5 * threads
    assert wasserstein([[0.0]], [[1.0]]) == 1


def test_interruption_on_a_line():
    """Sorting ten million numbers takes far longer than until Ctrl-C is seen."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(5_000_000, 1)), rng.normal(size=(5_000_000, 1))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    start = time.process_time()
    emd(x, y)
    whole = time.process_time() - start
    threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    start = time.process_time()
    with pytest.raises(KeyboardInterrupt):
        emd(x, y)
    assert time.process_time() - start < 0.75 * whole


MEMORY = """
import resource, sys
import numpy as np
from nfpde import _rust_ot
rng = np.random.default_rng(0)
x, y = rng.normal(size=(20000, 6)), 0.5 + 1.2 * rng.normal(size=(20000, 6))
a = b = None
if sys.argv[1] == "random":
    a, b = rng.exponential(size=20000), rng.exponential(size=20000)
    a, b = a / a.sum(), b / b.sum()
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 200 * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
print(_rust_ot.solve_points(x, y, a, b, "euclidean", 1)[6])
"""


@pytest.mark.slow
@pytest.mark.parametrize("weights", ["uniform", "random"])
def test_memory_of_twenty_thousand_points(weights):
    """20,000 against 20,000 points (a table of 3.2 GB) are solved within 200 MB."""
    result = subprocess.run(
        [sys.executable, "-c", MEMORY, weights], capture_output=True, text=True, timeout=600, check=False
    )
    assert result.returncode == 0, result.stderr
    assert abs(float(result.stdout)) < 1e-12
