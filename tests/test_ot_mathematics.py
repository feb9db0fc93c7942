"""nfpde.ot against closed forms, bounds, invariances and the axioms of a metric."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import sqrtm
from scipy.stats import wasserstein_distance

from nfpde.ot import emd, emd_matrix, wasserstein
from tests.ot_cases import check_certificate, clouds, distances, masses

#: Rounding only: the same optimum computed by another route.
SAME = 1e-12
#: Slack of an inequality between two computed numbers.
ROUNDING = 1e-12


@pytest.mark.parametrize("weights", ["uniform", "random", "skewed"])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 5), (40, 40), (41, 40), (30, 77)])
def test_on_a_line_the_cumulated_masses_give_w1(n, m, weights):
    """In one dimension W1 is the area between the two distribution functions."""
    x, y = clouds("gauss", n, m, 1)
    a, b = masses(weights, n, m)
    expected = wasserstein_distance(x[:, 0], y[:, 0], a, b)
    assert wasserstein(x, y, 1, a, b) == pytest.approx(expected, rel=SAME)
    result = emd(x, y, a, b)
    check_certificate(result, distances(x, y), a, b)


@pytest.mark.parametrize("p", [1, 1.5, 2, 3])
def test_on_a_line_sorting_gives_every_order(p):
    """In one dimension with equal weights the sorted points are matched in order, for every p."""
    x, y = clouds("mix", 60, 60, 1)
    expected = np.mean(np.abs(np.sort(x[:, 0]) - np.sort(y[:, 0])) ** p) ** (1 / p)
    assert wasserstein(x, y, p) == pytest.approx(expected, rel=SAME)


def test_points_on_a_common_line_in_space():
    """Points of a line in R^5 have the distance of their positions along it."""
    s, t = clouds("gauss", 50, 61, 1)
    direction = np.array([1.0, -2.0, 0.5, 3.0, -1.0])
    direction /= np.linalg.norm(direction)
    a, b = masses("random", 50, 61)
    assert wasserstein(s * direction, t * direction, 1, a, b) == pytest.approx(wasserstein(s, t, 1, a, b), rel=SAME)


def test_one_atom_takes_everything():
    """Against a single atom the cost is the weighted mean of the distances."""
    x, y = clouds("mix", 70, 1, 4)
    a, _ = masses("random", 70, 1)
    assert emd(x, y, a).cost == pytest.approx(a @ distances(x, y)[:, 0], rel=SAME)
    assert emd(y, x, None, a).cost == pytest.approx(a @ distances(x, y)[:, 0], rel=SAME)


def test_two_atoms_are_filled_in_order_of_the_cost_difference():
    """Against two atoms the points with the least c_i1 - c_i2 go to the first until it is full."""
    x, y = clouds("gauss", 200, 2, 3)
    a, b = masses("random", 200, 2)
    cost = distances(x, y)
    order = np.argsort(cost[:, 0] - cost[:, 1])
    to_first = np.clip(b[0] - (np.cumsum(a[order]) - a[order]), 0, a[order])
    expected = to_first @ cost[order, 0] + (a[order] - to_first) @ cost[order, 1]
    assert emd(x, y, a, b).cost == pytest.approx(expected, rel=SAME)


@pytest.mark.parametrize("d", [1, 2, 6])
def test_translation(d):
    """A moved and shuffled copy is as far as it was moved, for both orders."""
    x, _ = clouds("mix", 80, 1, d)
    move = np.linspace(-0.3, 0.8, d)
    y = np.random.default_rng(0).permutation(x + move)
    assert wasserstein(x, y, 1) == pytest.approx(np.linalg.norm(move), rel=1e-11)
    assert wasserstein(x, y, 2) == pytest.approx(np.linalg.norm(move), rel=1e-11)


def test_means_split_off_the_squared_cost():
    """W2^2 is W2^2 of the centred sets plus the squared distance of the means."""
    x, y = clouds("gauss", 90, 70, 3)
    a, b = masses("random", 90, 70)
    mean_x, mean_y = a @ x, b @ y
    centred = emd(x - mean_x, y - mean_y, a, b, "sqeuclidean").cost
    assert emd(x, y, a, b, "sqeuclidean").cost == pytest.approx(centred + np.sum((mean_x - mean_y) ** 2), rel=SAME)


def test_monotone_affine_map_and_gelbrich_bound():
    """Y = S x + t with S positive definite is optimal for the squared cost and attains Gelbrich's bound."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(120, 3))
    root = rng.normal(size=(3, 3))
    matrix = root @ root.T + 0.1 * np.eye(3)
    y = x @ matrix + np.array([1.0, -2.0, 0.5])
    result = emd(x, y, metric="sqeuclidean")
    assert result.plan.cols.tolist() == list(range(120))
    assert result.cost == pytest.approx(_gelbrich(x, y), rel=1e-9)  # sqrtm keeps about half the digits
    other = rng.normal(size=(120, 3)) ** 3
    assert emd(x, other, metric="sqeuclidean").cost > _gelbrich(x, other)


def _gelbrich(x, y):
    cov_x, cov_y = np.cov(x.T, bias=True), np.cov(y.T, bias=True)
    root = sqrtm(cov_x)
    cross = np.trace(np.real(sqrtm(root @ cov_y @ root)))
    return np.sum((x.mean(0) - y.mean(0)) ** 2) + np.trace(cov_x) + np.trace(cov_y) - 2 * cross


@pytest.mark.parametrize("kind", ["gauss", "mix", "lattice"])
def test_bounds(kind):
    """W1 lies between the distance of the means, its projections, W2 and the city-block cost."""
    x, y = clouds(kind, 60, 50, 4)
    a, b = masses("random", 60, 50)
    w1, w2 = wasserstein(x, y, 1, a, b), wasserstein(x, y, 2, a, b)
    l1 = emd(x, y, a, b, "cityblock").cost
    assert w1 >= np.linalg.norm(a @ x - b @ y) - ROUNDING
    for axis in np.random.default_rng(0).normal(size=(10, 4)):
        axis /= np.linalg.norm(axis)
        assert w1 >= wasserstein((x @ axis)[:, None], (y @ axis)[:, None], 1, a, b) - ROUNDING
    assert w1 <= w2 + ROUNDING
    assert w1 - ROUNDING <= l1 <= 2 * w1 + ROUNDING
    assert w2 <= wasserstein(x, y, 2.5, a, b) + ROUNDING


def test_invariances():
    """Order, argument swap, rotation, split atoms, merged duplicates and empty atoms change nothing."""
    rng = np.random.default_rng(5)
    x, y = clouds("mix", 40, 33, 3)
    a, b = masses("random", 40, 33)
    value = wasserstein(x, y, 1, a, b)
    order = rng.permutation(40)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    half = np.where(np.arange(40) == 7, 0.5, 1.0)
    assert wasserstein(x[order], y, 1, a[order], b) == pytest.approx(value, rel=SAME)
    assert wasserstein(y, x, 1, b, a) == pytest.approx(value, rel=SAME)
    assert wasserstein(x @ rotation, y @ rotation, 1, a, b) == pytest.approx(value, rel=SAME)
    split = np.append(a * half, a[7] / 2)
    assert wasserstein(np.vstack([x, x[7:8]]), y, 1, split, b) == pytest.approx(value, rel=SAME)
    far = np.full((1, 3), 1e3)
    assert wasserstein(np.vstack([x, far]), np.vstack([far, y]), 1, np.append(a, 0), np.append(0, b)) == pytest.approx(
        value, rel=SAME
    )
    assert wasserstein(x, y, 1, 5 * a, 5 * b) == pytest.approx(value, rel=SAME)
    assert emd(x, y, 5 * a, 5 * b).cost == pytest.approx(5 * value, rel=SAME)
    assert wasserstein(x, y, 2) == pytest.approx(wasserstein(x, y, 2, np.ones(40), np.full(33, 40 / 33)), rel=SAME)


@pytest.mark.parametrize("metric", ["euclidean", "sqeuclidean", "cityblock"])
@pytest.mark.parametrize("exponent", [-400, -60, 3, 400])
def test_scaling_by_a_power_of_two_keeps_the_bits(metric, exponent):
    """Scaling by a power of two scales the cost without rounding, as far as numbers reach."""
    x, y = clouds("gauss", 30, 31, 3)
    power = 2 if metric == "sqeuclidean" else 1
    scale = 2.0**exponent
    assert emd(x * scale, y * scale, metric=metric).cost == emd(x, y, metric=metric).cost * scale**power


@pytest.mark.parametrize("p", [1, 2, 3])
@pytest.mark.parametrize("scale", [1e-300, 1e-200, 1e-20, 1e20, 1e200, 1e300])
def test_distances_hold_at_any_scale(p, scale):
    """A distance is as large as its points are, near both ends of the range of numbers too."""
    x, y = clouds("mix", 25, 25, 2)
    assert wasserstein(x * scale, y * scale, p) == pytest.approx(wasserstein(x, y, p) * scale, rel=1e-11)


@pytest.mark.parametrize("p", [1, 2, 3])
@pytest.mark.parametrize("kind", ["mix", "lattice"])
def test_axioms_of_a_metric(kind, p):
    """W(X, X) = 0, symmetry, the triangle inequality."""
    x, y = clouds(kind, 30, 41, 3)
    z, _ = clouds(kind, 23, 1, 3, seed=9)
    assert wasserstein(x, x, p) == 0
    assert wasserstein(x, np.random.default_rng(1).permutation(x), p) == 0
    assert wasserstein(x, y, p) == pytest.approx(wasserstein(y, x, p), rel=SAME)
    assert wasserstein(x, z, p) <= wasserstein(x, y, p) + wasserstein(y, z, p) + ROUNDING


@pytest.mark.parametrize("n", [1, 2, 20])
def test_all_points_equal(n):
    """Equal points cost nothing, whatever their masses."""
    point = np.full((n, 3), 1.7)
    a, b = masses("random", n, n)
    assert emd(point, point, a, b).cost == 0


@pytest.mark.parametrize("offset", [1e6, 1e8])
def test_offset_of_the_data(offset):
    """Far from the origin the answer is that of the rounded points: differences are taken directly."""
    x, y = clouds("gauss", 50, 50, 4)
    x, y = x + offset, y + offset
    assert wasserstein(x, y) == pytest.approx(wasserstein(x - offset, y - offset), rel=SAME)


def test_a_huge_coordinate_that_all_points_share():
    """A coordinate that is the same everywhere plays no part, in the potentials neither."""
    x, y = clouds("gauss", 20, 20, 3)
    x[:, 1], y[:, 1] = 1e308, 1e308
    result = emd(x, y)
    check_certificate(result, distances(x[:, ::2], y[:, ::2]), *masses("uniform", 20, 20))


def test_outliers_do_not_drown_the_rest():
    """A far pair of equal points leaves the distance of the others accurate."""
    x, y = clouds("gauss", 50, 50, 2)
    far = np.full((1, 2), 1e6)
    value = emd(x, y, metric="sqeuclidean").cost
    both = emd(np.vstack([x, far]), np.vstack([y, far]), metric="sqeuclidean").cost
    assert both == pytest.approx(value * 50 / 51, rel=1e-9)  # an arc of cost 1e12 is known to 1e-4


def test_weights_over_eighteen_decades():
    """Atoms of all sizes: the margins keep the large ones, the cost is that of the closed form."""
    a = 10.0 ** -np.arange(19)
    x = np.random.default_rng(0).normal(size=(19, 3))
    y = np.array([[3.0, 0, 0], [0, 4.0, 0]])
    b = np.array([a.sum(), 0.0])
    assert emd(x, y, a, b).cost == pytest.approx(a @ distances(x, y)[:, 0], rel=SAME)
    b = a[::-1].copy()
    z = np.random.default_rng(1).normal(size=(19, 3))
    check_certificate(emd(x, z, a, b), distances(x, z), a, b)


def test_weights_and_costs_of_very_different_sizes():
    """Masses of 1e-20 and costs of 1e12 in one problem leave the certificate whole."""
    rng = np.random.default_rng(4)
    x, y = rng.normal(size=(12, 3)) * 10.0 ** rng.integers(-6, 7, (12, 1)), rng.normal(size=(15, 3))
    a, b = rng.exponential(size=12) ** 9, rng.exponential(size=15) ** 9
    a, b = a / a.sum(), b / b.sum()
    check_certificate(emd(x, y, a, b, "sqeuclidean"), distances(x, y, "sqeuclidean"), a, b)


@pytest.mark.parametrize("scale", [1e-20, 1e-300, 1e300])
def test_matrix_scale(scale):
    """The scale of a cost matrix scales the answer."""
    cost = distances(*clouds("gauss", 30, 20, 3)) / 10
    assert emd_matrix(cost * scale).cost == pytest.approx(emd_matrix(cost).cost * scale, rel=SAME)
