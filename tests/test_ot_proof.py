"""nfpde.ot proves what it returns: exact rational arithmetic on its potentials, over all pairs."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from nfpde.errors import NotOptimal
from nfpde.ot import EmdResult, emd, emd_matrix
from tests.ot_cases import least_size, unproven

#: What may be left unproven of any cost.
GAP = 1e-12
#: Units in the last place of what the dual value is made of: eight that the solver excuses, and those of a cost and of
#: potentials that are lowered to fit every pair exactly.
ROUNDINGS = 12 * np.finfo(float).eps


def _equal(rng, n):
    return np.full(n, 1 / n)


def _random(rng, n):
    raw = rng.exponential(size=n)
    return raw / raw.sum()


def _heavy(rng, n):
    raw = rng.exponential(size=n)
    raw[rng.integers(n)] = 1e15
    return raw / raw.sum()


def _decades(rng, n):
    raw = rng.exponential(size=n) * 10.0 ** -rng.integers(0, 40, n)
    return raw / raw.sum()


def _gauss(rng, n, m):
    return rng.normal(size=(n, 3)), 0.5 + 1.2 * rng.normal(size=(m, 3))


def _clusters(rng, n, m):
    centres = rng.normal(size=(3, 3))
    near = [centres[rng.integers(0, 3, k)] + 1e-3 * rng.normal(size=(k, 3)) for k in (n, m)]
    return near[0], near[1] + 0.1


def _duplicates(rng, n, m):
    points = rng.normal(size=(4, 3))
    return points[rng.integers(0, 4, n)], points[rng.integers(0, 4, m)] + np.array([0.5, 0, 0])


def _lattice(rng, n, m):
    return rng.integers(0, 3, (n, 3)) + 0.0, rng.integers(0, 3, (m, 3)) + np.array([0, 0, 3.0])


def _offset(rng, n, m):
    x, y = _gauss(rng, n, m)
    return x + 1e8, y + 1e8


def _coincident(rng, n, m):
    x = rng.normal(size=(n, 3))
    return x, x[rng.integers(0, n, m)] + 1e-12 * rng.normal(size=(m, 3))


def _line(rng, n, m):
    return rng.normal(size=(n, 1)), 10.0 ** rng.integers(-9, 9, (m, 1)) * rng.normal(size=(m, 1))


CLOUDS = {
    "gauss": _gauss,
    "clusters": _clusters,
    "duplicates": _duplicates,
    "lattice": _lattice,
    "offset": _offset,
    "coincident": _coincident,
    "line": _line,
}
WEIGHTS = {"equal": _equal, "random": _random, "heavy": _heavy, "decades": _decades}


def _costs(x: np.ndarray, y: np.ndarray, metric: str) -> np.ndarray:
    """Costs coordinate by coordinate, as the solver adds them up: the very same floats."""
    steps = x[:, None] - y
    terms = np.abs(steps) if metric == "cityblock" else steps * steps
    sums = terms[..., 0].copy()
    for k in range(1, terms.shape[2]):
        sums += terms[..., k]
    return np.sqrt(sums) if metric == "euclidean" else sums


def _check(result: EmdResult, cost: np.ndarray, a: np.ndarray, b: np.ndarray) -> None:
    as_given, proven = unproven(result, cost, a, b)
    size = least_size(*result.potentials, a, b)
    allowed = GAP * abs(result.cost) + ROUNDINGS * size
    assert abs(proven) <= allowed
    assert abs(as_given) <= allowed
    assert abs(as_given - Fraction(result.gap)) <= 4 * np.finfo(float).eps * (abs(result.cost) + size)


@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("clouds", CLOUDS)
def test_every_answer_is_proven_in_exact_arithmetic(clouds, weights):
    """No answer is more than 1e-12 of its cost above a bound, but for units in the last place of what makes it up."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        n, m = rng.integers(1, 15, 2)
        x, y = CLOUDS[clouds](rng, n, n if clouds == "coincident" and seed % 2 else m)
        a, b = WEIGHTS[weights](rng, len(x)), WEIGHTS[weights](rng, len(y))
        metric = ("euclidean", "sqeuclidean", "cityblock")[seed % 3]
        cost = _costs(x, y, metric)
        _check(emd(x, y, a, b, metric), cost, a, b)
        _check(emd_matrix(cost, a, b), cost, a, b)


def test_points_with_hardly_any_mass_that_pay_all_of_the_cost():
    """Costs over forty decades, one point with nearly all mass and one with none: nothing is excused."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        n, m = rng.integers(3, 20, 2)
        cost = _costs(rng.normal(size=(n, 3)), rng.normal(size=(m, 3)), "euclidean") ** 40
        cost /= cost.max()
        a, b = np.ones(n), _heavy(rng, m)
        a[0] = 0.0
        a /= a.sum()
        for c, left, right in ((cost, a, b), (np.ascontiguousarray(cost.T), b, a)):
            result = emd_matrix(c, left, right)
            as_given, proven = unproven(result, c, left, right)
            assert max(abs(proven), abs(as_given), abs(Fraction(result.gap))) <= GAP * result.cost


def test_masses_are_the_weights_however_small():
    """A light atom that alone pays: cost is its weight times its distance, over as many decades as weights have."""
    for weight in (1e-9, 1e-18, 1e-25, 1e-60):
        for far in ([0.0, 3.0], [1.8, 2.4]):
            result = emd([[0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], far], [1.0, weight], [1.0, weight])
            assert result.cost == pytest.approx(3 * weight, rel=GAP, abs=0)


@pytest.mark.parametrize("middle", [((0, 0), (0, 1)), ((0, 0), (1, 0))])
@pytest.mark.parametrize("lighter", [0.5, 0.9])
def test_light_points_whose_errors_cancel(middle, lighter):
    """Light points of both sides at both ends of a line: what the one lacks the other has, an end apart.

    By symmetry the middle pays 1, and half of the light mass (a tenth of it) goes from end to end, 2 R at 1 / R each.
    """
    e, far = 2.0**-66, 2.0**66
    ends = [[far, 0.0], [-far, 0.0]]
    left, right = [1.0, e, lighter * e], [1.0, lighter * e, e]
    result = emd([middle[0], *ends], [middle[1], *ends], left, right)
    assert result.cost == pytest.approx(1 + 2 * (1 - lighter), rel=1e-9)
    cost = _costs(np.array([middle[0], *ends], float), np.array([middle[1], *ends], float), "euclidean")
    assert emd_matrix(cost, left, right).cost == pytest.approx(1 + 2 * (1 - lighter), rel=1e-9)


def test_totals_that_differ_are_one_total_in_proportion():
    """The weights of y count as shares of the total of x, down to the lightest."""
    x, y = [[0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 3.0]]
    cost = emd(x, y, [1.0, 1.0], [2.0 * (1 + 5e-10), 1e-18]).cost
    assert cost == pytest.approx(3e-18 / (1 + 5e-10), rel=GAP, abs=0)


def test_equal_clouds_cost_nothing():
    """A cost of zero is an answer with a gap of zero."""
    rng = np.random.default_rng(0)
    for weights in WEIGHTS.values():
        x, order = rng.normal(size=(20, 3)), rng.permutation(20)
        a = weights(rng, 20)
        result = emd(x, x[order], a, a[order])
        assert (result.cost, result.gap) == (0, 0)


def test_what_cannot_be_told_is_refused():
    """A weight that vanishes among the others, and pays all of the cost."""
    for far in ([0.0, 3.0], [1.8, 2.4]):
        with pytest.raises(NotOptimal, match=r"unproven.*leave out points"):
            emd([[0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], far], [1.0, 1e-90], [1.0, 1e-90])
