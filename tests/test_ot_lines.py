"""nfpde.ot on a line along an axis, for any order, and what wasserstein does to points and weights beforehand."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from nfpde.errors import BadInput
from nfpde.ot import emd, emd_matrix, wasserstein
from tests.ot_cases import check_certificate, clouds, distances, masses

#: Two exact solvers differ by rounding only.
SAME = 1e-12


def _sorted_distance(x: np.ndarray, y: np.ndarray, p: float) -> float:
    return float(np.mean(np.abs(np.sort(x, axis=None) - np.sort(y, axis=None)) ** p) ** (1 / p))


@pytest.mark.parametrize("p", [1.5, 3, 7.25])
@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_every_order_beyond_the_table(p, scale):
    """More points than a table is kept for, sorted."""
    x, y = clouds("gauss", 20_000, 20_000, 1)
    expected = _sorted_distance(x, y, p) * scale
    assert wasserstein(x * scale, y * scale, p) == pytest.approx(expected, rel=SAME)
    third = np.full((20_000, 1), 0.7)
    assert wasserstein(np.hstack([third, x]), np.hstack([third, y]), p) == pytest.approx(expected / scale, rel=SAME)


@pytest.mark.parametrize("p", [1.5, 3])
@pytest.mark.parametrize("weights", ["random", "skewed"])
def test_every_order_with_weights_agrees_with_the_simplex(p, weights):
    """The same costs given as a matrix."""
    x, y = clouds("mix", 40, 31, 1)
    a, b = masses(weights, 40, 31)
    expected = emd_matrix(distances(x, y) ** p, a, b).cost ** (1 / p)
    assert wasserstein(x, y, p, a, b) == pytest.approx(expected, rel=SAME)


def test_a_light_point_that_is_far_counts_at_its_order():
    """A weight of 1e-30 at a distance of 1e15 is nothing to the first order and all of it to the third."""
    x, y, a = [[0.0], [0.0]], [[0.5], [1e15]], [1.0, 1e-30]
    assert wasserstein(x, y, 1, a, a) == pytest.approx(0.5, rel=SAME)
    assert wasserstein(x, y, 3, a, a) == pytest.approx(1e5, rel=SAME)


@pytest.mark.parametrize("metric", ["euclidean", "sqeuclidean", "cityblock"])
@pytest.mark.parametrize("column", [0, 1])
def test_a_column_that_is_constant_leaves_a_line(metric, column):
    """Any number of points is solved by sorting, as without the column, with the same potentials."""
    x, y = clouds("gauss", 2050, 2050, 1)
    wide_x, wide_y = np.insert(x, column, 3.25, axis=1), np.insert(y, column, 3.25, axis=1)
    line, plane = emd(x, y, metric=metric), emd(wide_x, wide_y, metric=metric)
    assert plane.cost == line.cost
    assert np.array_equal(plane.potentials[0], line.potentials[0])
    check_certificate(plane, distances(wide_x, wide_y, metric), *masses("uniform", 2050, 2050))


def test_other_orders_keep_one_number_for_a_pair():
    """Costs are written once, in place."""
    x, y = clouds("gauss", 600, 500, 2)
    tracemalloc.start()
    wasserstein(x, y, 3)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1.2 * 8 * 600 * 500


@pytest.mark.parametrize("p", [1, 1.5, 2, 3])
def test_a_coordinate_that_is_shared_sets_no_scale(p):
    """However large it is, beside however small a difference."""
    assert wasserstein([[1e200, 0.0]], [[1e200, 1e-200]], p) == pytest.approx(1e-200, rel=SAME)
    assert wasserstein([[1e200, 0.0], [1e200, 0.0]], [[1e200, 0.0]], p) == 0


@pytest.mark.parametrize("p", [1, 1.5, 2, 3])
@pytest.mark.parametrize("total", [1e-200, 1e200])
def test_only_shares_of_the_weights_count(p, total):
    """The product of weight and distance may lie outside the range of numbers."""
    assert wasserstein([[0.0]], [[total]], p, [total], [total]) == pytest.approx(total, rel=SAME)
    x, y = [[0.0, 0.0], [0.0, 0.0]], [[3 * total, 4 * total], [3 * total, 4 * total]]
    assert wasserstein(x, y, p, [total, total], [2 * total, 0.0]) == pytest.approx(5 * total, rel=SAME)


def test_the_least_difference_is_no_zero():
    """Distances below normal numbers are refused, or hold."""
    with pytest.raises(BadInput, match="outside the range of numbers"):
        emd([[0.0]], [[5e-324]])
    for p in (1, 2, 3):
        assert wasserstein([[0.0]], [[5e-324]], p) == 5e-324


def test_whole_numbers_that_floats_do_not_hold_are_refused():
    """Rounded, they would be other points; those that floats hold are taken, however large."""
    large = 2**62
    assert emd([[large]], [[large + 2**12]]).cost == 2**12
    assert emd(np.array([[2**63]], np.uint64), np.array([[2**63 + 2**11]], np.uint64)).cost == 2**11
    with pytest.raises(BadInput, match=r"y\[1, 0\] is 4611686018427387905: float64 does not hold .* subtract"):
        emd([[large]], [[large], [large + 1]])
    with pytest.raises(BadInput, match=r"cost\[0, 1\] is -9007199254740993"):
        emd_matrix([[0, -(2**53) - 1]])
    with pytest.raises(BadInput, match=r"a\[0\] is 18446744073709551615"):
        emd([[0.0]], [[1.0]], np.array([2**64 - 1], np.uint64))
