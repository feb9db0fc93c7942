"""nfpde.ot where some costs are far larger than what a plan pays: the digits that decide are still there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from nfpde.errors import BadInput
from nfpde.ot import emd, emd_matrix, wasserstein
from tests.ot_cases import distances, unproven

#: Rounding of a dozen products, and what may be left unproven of any cost.
ROUNDING = 1e-12
#: What potentials may exceed costs by, as a share of the cost, since they are rounded.
DOUBT = 1e-6


def _least(cost: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """The optimum for masses that are whole numbers, which an assignment of single units reaches."""
    units = cost[np.repeat(np.arange(len(a)), a)][:, np.repeat(np.arange(len(b)), b)]
    return float(units[linear_sum_assignment(units)].sum())


def test_the_better_of_two_plans_beside_points_a_million_times_as_far():
    """Weights and near points are dyadic: the cheaper plan, which moves every point to its own, has an exact cost."""
    x = [[0.875, 0.5], [0.5, 0.25], [1e8, 0], [2e8, 0]]
    y = [[0.5, 1.0], [0.25, 0.75], [1e8, 0], [2e8, 0]]
    a = np.array([1, 3, 7, 1]) / 16
    result = emd(x, y, a, a, "sqeuclidean")
    straight = (a * ((np.array(x) - np.array(y)) ** 2).sum(axis=1)).sum()
    assert result.cost == straight == 0.0830078125
    assert abs(result.gap) <= ROUNDING * result.cost
    assert wasserstein(x, y, 2, a, a) == pytest.approx(np.sqrt(straight / a.sum()), rel=ROUNDING)


@pytest.mark.parametrize("metric", ["euclidean", "sqeuclidean", "cityblock"])
@pytest.mark.parametrize("scale", [1e7, 1e8, 1e12])
def test_far_points_that_both_clouds_share_change_nothing(metric, scale):
    """What stays where it is costs nothing, and the others pay what they pay alone."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        n, far = rng.integers(2, 6), np.array([[scale, 0], [2 * scale, 0]])
        x, y = rng.random((n, 2)), rng.random((n, 2))
        a, shared = rng.integers(1, 8, n), rng.integers(1, 8, 2)
        b = a[rng.permutation(n)]
        left, right = np.append(a, shared), np.append(b, shared)
        result = emd(np.vstack([x, far]), np.vstack([y, far]), left / 16, right / 16, metric)
        near = distances(x, y, metric)
        assert result.cost == pytest.approx(_least(near, a, b) / 16, rel=ROUNDING), seed
        assert abs(result.gap) <= ROUNDING * result.cost
        all_pairs = distances(np.vstack([x, far]), np.vstack([y, far]), metric)
        assert max(unproven(result, all_pairs, left / 16, right / 16)) <= DOUBT * result.cost


@pytest.mark.parametrize("forbidden", [1e6, 1e12, 1e18, 1e300])
def test_a_constant_for_forbidden_pairs_may_be_as_large_as_numbers_are(forbidden):
    """However large it is, the plan is the best of those that do without."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        n = rng.integers(3, 8)
        cost, never = rng.random((n, n)) - 0.25, rng.random((n, n)) < 0.6
        np.fill_diagonal(never, False)
        a = rng.integers(1, 6, n)
        result = emd_matrix(np.where(never, forbidden, cost), a / 8, a / 8)
        assert result.cost == pytest.approx(_least(np.where(never, 1e3, cost), a, a) / 8, rel=1e-11, abs=ROUNDING)
        assert not never[result.plan.rows, result.plan.cols].any()


@pytest.mark.parametrize("weight", [1e-17, 1e-22, 1e-40])
def test_a_light_point_may_have_to_pay_what_others_never_do(weight):
    """It has no choice, and others go on as without it, at the digits that decide for them."""
    rng = np.random.default_rng(3)
    n, large = 5, 1e-4 / weight
    cost, never = rng.random((n, n)), rng.random((n, n)) < 0.6
    np.fill_diagonal(never, False)
    a = rng.integers(1, 6, n)
    expected = _least(np.where(never, 1e3, cost), a, a) / 8
    wide = np.full((n + 1, n + 1), large)
    wide[:n, :n] = np.where(never, 1e30, cost)
    weights = np.append(a / 8, weight)
    assert emd_matrix(wide, weights, weights).cost == pytest.approx(expected + 1e-4, rel=ROUNDING)


@pytest.mark.parametrize("n", [60, 1100, 2050])
def test_far_points_of_large_clouds(n):
    """Where short lists of pairs are searched, too, and where there are too many pairs for a table."""
    rng = np.random.default_rng(n)
    x, y, a = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), rng.exponential(size=n)
    a, b, far = a / (2 * a.sum()), np.roll(a, 7) / (2 * a.sum()), np.array([[1e8] * 3, [-1e8] * 3])
    near = emd(x, y, a, b, "sqeuclidean")
    both = emd(
        np.vstack([x, far]), np.vstack([y, far]), np.append(a, [0.25] * 2), np.append(b, [0.25] * 2), "sqeuclidean"
    )
    assert both.cost == pytest.approx(near.cost, rel=1e-11)
    assert abs(both.gap) <= ROUNDING * both.cost


@pytest.mark.parametrize("metric", ["euclidean", "sqeuclidean", "cityblock"])
@pytest.mark.parametrize("n", [5, 40, 300])
def test_clouds_that_coincide_but_for_rounding_have_an_answer(metric, n):
    """What is left unproven is small beside the cost, or beside a rounding of all weights along the longest way."""
    for spread in (0.0, 1e-16, 1e-12, 1e-6):
        rng = np.random.default_rng(n)
        x, order, a = rng.normal(size=(n, 3)), rng.permutation(n), rng.exponential(size=n)
        b = a[order] * (1 + 1e-15 * rng.normal(size=n))
        y = x[order] + spread * rng.normal(size=(n, 3))
        result = emd(x, y, a / a.sum(), b / b.sum(), metric)
        farthest = distances(x[result.plan.rows], y[result.plan.cols], metric).diagonal().max()
        assert abs(result.gap) <= max(DOUBT * result.cost, 8 * np.finfo(float).eps * farthest)
        equal = emd(x, y, metric=metric)
        assert abs(equal.gap) <= ROUNDING * equal.cost


def test_large_clouds_that_nearly_coincide():
    """A cost of 1e-24 of the largest is proven like any other, with more pairs than a table is kept for."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(2050, 3))
    step = 1e-12 * rng.normal(size=x.shape)
    result = emd(x, x + step, metric="sqeuclidean")
    assert result.cost == pytest.approx(((x + step - x) ** 2).sum(axis=1).mean(), rel=ROUNDING)
    assert abs(result.gap) <= ROUNDING * result.cost


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2)])
def test_costs_that_vanish_all_are_refused(order):
    """Squares of 1e-200 are zero, and all plans alike: no number is returned for one of them."""
    x, y = np.array([[0, 0], [0, 3e-200], [1, 1]]), np.array([[0, 1e-200], [0, 4e-200], [1, 1]])
    with pytest.raises(BadInput, match="outside the range of numbers"):
        emd(x, y[list(order)])
    tiny = np.array([[5e-150, 1e-150, 1e200], [1e-150, 5e-150, 1e200], [1e200, 1e200, 0]])
    with pytest.raises(BadInput, match="outside the range of numbers"):
        emd_matrix(tiny)
