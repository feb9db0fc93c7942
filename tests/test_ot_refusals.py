"""nfpde.ot refuses what has no right answer, and says where and why."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from nfpde.errors import BadInput
from nfpde.ot import emd, emd_matrix, wasserstein

X = np.arange(12.0).reshape(4, 3)
Y = np.arange(15.0).reshape(5, 3)


def _spoil(array, place, value):
    array = np.array(array, dtype=float)
    array[place] = value
    return array


BAD_POINTS = [
    (_spoil(X, (2, 1), np.nan), Y, r"x\[2, 1\] is NaN: coordinates must be finite"),
    (X, _spoil(Y, (4, 0), np.inf), r"y\[4, 0\] is inf: coordinates must be finite"),
    (X, _spoil(Y, (0, 2), -np.inf), r"y\[0, 2\] is -inf"),
    (np.zeros((0, 3)), Y, r"x has shape \(0, 3\): it is empty"),
    (X, np.zeros((5, 0)), r"y has shape \(5, 0\): it is empty"),
    (X[:, :2], Y, "x has 2 coordinates a point and y has 3"),
    (X[0], Y, r"x has shape \(3,\): it must have 2 dimensions"),
    (X, Y[None], r"y has shape \(1, 5, 3\)"),
    (X.astype(complex), Y, "x has dtype complex128: it must hold real numbers"),
    (X, [["a", "b", "c"]], "y has dtype <U1"),
    ([[1.0, 2.0, 3.0], [1.0]], Y, "x cannot be read as an array"),
    (torch.ones(4, 3, requires_grad=True), Y, "x cannot be read as an array on the CPU"),
    (np.ma.masked_less(X, np.median(X)), Y, "x is masked in part: leave its masked rows out"),
    (list(np.ma.masked_less(X, np.median(X))), Y, "x is masked in part: leave its masked rows out"),
]


@pytest.mark.parametrize(("x", "y", "text"), BAD_POINTS)
def test_points(x, y, text):
    """Points that are not finite, not there or of the wrong shape."""
    with pytest.raises(BadInput, match=text):
        emd(x, y)
    for p in (1, 2, 3):
        with pytest.raises(BadInput, match=text.replace("NaN", "(?i:nan)")):
            wasserstein(x, y, p)


BAD_WEIGHTS = [
    ([0.25, 0.25, -0.1, 0.6], None, r"a\[2\] is -0.1: weights must not be negative"),
    ([0.25, np.nan, 0.5, 0.25], None, r"a\[1\] is NaN: weights must be finite"),
    (None, [0.2, 0.2, 0.2, 0.2, np.inf], r"b\[4\] is inf: weights must be finite"),
    (np.zeros(4), None, "a has no mass: all its 4 weights are zero"),
    (np.full(4, 0.25), np.zeros(5), "b has no mass"),
    (np.full(4, 0.25), np.full(5, 0.2 + 1e-8), "one total .* a sums to 1 and b to 1.00000005"),
    (np.full(3, 1 / 3), None, "a has 3 weights for 4 points"),
    (None, np.full((5, 1), 0.2), r"b has shape \(5, 1\): weights have 1 dimension"),
    (np.full(4, 1e308), np.full(5, 0.8e308), "sum to infinity"),
    (np.full(4, 1e-300), np.full(5, 0.8e-300), "sum to 4e-300: scale them up"),
]


@pytest.mark.parametrize(("a", "b", "text"), BAD_WEIGHTS)
@pytest.mark.parametrize("p", [1, 2, 3])
def test_weights(a, b, text, p):
    """Weights that are not masses, or do not balance."""
    with pytest.raises(BadInput, match=text):
        wasserstein(X, Y, p, a, b)
    with pytest.raises(BadInput, match=text):
        emd_matrix(np.ones((4, 5)), a, b)


def test_weights_that_differ_by_rounding_are_accepted():
    """Totals that agree to 1e-9 are one total."""
    a, b = np.full(4, 0.25), np.full(5, 0.2 + 1e-10 / 5)
    assert wasserstein(X, Y, 1, a, b) == pytest.approx(wasserstein(X, Y), rel=1e-9)


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_squares_outside_the_range_of_numbers(scale):
    """A squared cost that over- or underflows is refused, not rounded to infinity or zero."""
    with pytest.raises(BadInput, match="outside the range of numbers"):
        emd(X * scale, Y * scale + scale, metric="sqeuclidean")


def test_largest_numbers():
    """Distances beyond the largest number are refused."""
    with pytest.raises(BadInput, match="outside the range of numbers"):
        emd([[1.7e308, 1.7e308]], [[-1.7e308, -1.7e308]])
    assert emd([[1.7e308, 0]], [[1.0e308, 0]]).cost == pytest.approx(0.7e308)
    for p in (1, 2, 3):
        with pytest.raises(BadInput, match="outside the range of numbers: rescale the points"):
            wasserstein([[1e308]], [[-1e308]], p)
        assert wasserstein([[0.8e308]], [[-0.8e308]], p) == pytest.approx(1.6e308, rel=1e-15)


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ([[0.0], [1e300]], [[1e-300], [1e300]]),
        ([[0.0, 0.0], [1e300, 0.0]], [[0.0, 1e-300], [1e300, 0.0]]),
        ([[0.0], [4.0]], [[5e-324], [4.0]]),
    ],
)
def test_coordinates_that_vanish_beside_others(x, y):
    """Points that differ are not one because others are so far that no unit holds both."""
    with pytest.raises(BadInput, match="outside the range of numbers"):
        emd(x, y)
    for p in (1, 2, 3):
        with pytest.raises(BadInput, match="outside the range of numbers"):
            wasserstein(x, y, p)
    assert wasserstein(x, x) == 0
    far = [[0.0] * len(x[0])] * 2
    assert emd(x, far).cost == x[1][0] / 2


def test_a_distance_that_vanishes_is_no_zero():
    """A weight of 1e-30 of the total, at 1e-300: no number is as small, and zero would say that nothing moves."""
    with pytest.raises(BadInput, match="outside the range of numbers"):
        wasserstein([[0.0], [0.0]], [[0.0], [1e-300]], 1, [1.0, 1e-30], [1.0, 1e-30])


def test_matrix():
    """A cost that is not finite, with its place."""
    with pytest.raises(BadInput, match=r"cost\[1, 2\] is NaN: costs must be finite"):
        emd_matrix(_spoil(np.ones((3, 4)), (1, 2), np.nan))
    with pytest.raises(BadInput, match=r"cost has shape \(0, 4\)"):
        emd_matrix(np.ones((0, 4)))
    with pytest.raises(BadInput, match=r"cost has shape \(2,\): it must have 2 dimensions, \(rows, columns\)"):
        emd_matrix([1.0, 2.0])


@pytest.mark.parametrize(
    "p",
    [
        0.5,
        0,
        -1,
        np.nan,
        np.inf,
        np.float32(np.inf),
        np.int64(0),
        pytest.param(10**400, id="beyond floats"),
        True,
        "2",
        None,
    ],
)
def test_order(p):
    """Orders below 1 do not give a metric; infinity is another problem."""
    with pytest.raises(BadInput, match="the order of a Wasserstein distance is a finite number, at least 1"):
        wasserstein(X, Y, p)


def test_order_too_large():
    """Costs that all vanish at a huge order are refused, not returned as distance zero."""
    with pytest.raises(BadInput, match="lower p"):
        wasserstein([[0.0, 0.0], [1e6, 1.0]], [[1e6, 0.0], [0.0, 1.0]], 5000)


def test_metric():
    """A metric that does not exist, with the choices."""
    with pytest.raises(BadInput, match="'cosine': choose one of euclidean, sqeuclidean, cityblock"):
        emd(X, Y, metric="cosine")  # type: ignore[arg-type]


@pytest.mark.parametrize("threads", [0, -1, 1.5, "2", 10**6, np.int64(0), np.float64(2), True])
def test_threads(threads):
    """A number of threads that makes no sense."""
    with pytest.raises(BadInput, match=r"threads is .* whole number"):
        emd(X, Y, threads=threads)
