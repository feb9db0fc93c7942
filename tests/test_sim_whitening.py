"""White innovations of residuals, and what whole recordings cost, against dense linear algebra."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_t

from nfpde.errors import BadInput
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator, Whitening, simulator
from nfpde.sim.whitening import DIVERGED
from tests.models import DOUBLE_PENDULUM, load, make_windows

C = 3


def factor(n, linked, seed=0):
    """A random whitening of n windows, and the dense lower factor of the covariance that it stands for."""
    rng = np.random.default_rng(seed)
    lower = np.zeros((n * C, n * C))
    own, carry = np.empty((2, n, C, C))
    for t in range(n):
        block = np.tril(rng.normal(size=(C, C))) + 2 * np.eye(C)
        own[t] = np.linalg.inv(block)
        share = rng.normal(size=(C, C))
        carry[t] = own[t] @ share
        lower[t * C : (t + 1) * C, t * C : (t + 1) * C] = block
        if linked[t]:
            lower[t * C : (t + 1) * C, (t - 1) * C : t * C] = share
    return Whitening(own, carry, np.array(linked), 4.0), lower


LINKS = [False, True, True, False, False, True]


def test_innovations_are_those_of_the_dense_factor():
    """Two vectors on chains of three, one and two windows: L^-1 r of the whole covariance L L'."""
    whitening, lower = factor(6, LINKS)
    r = np.random.default_rng(1).normal(size=(2, 6, C))
    white = whitening.whiten(r.reshape(12, C), np.repeat([0, 1], 6), np.tile(np.arange(6), 2))
    expected = np.linalg.solve(lower, r.reshape(2, -1).T).T
    # a well-conditioned factor of 18 rows in double precision
    np.testing.assert_allclose(white.reshape(2, -1), expected, rtol=1e-11, atol=1e-12)


def test_cost_is_the_density_of_students_t():
    """Windows on their own: differences of costs are minus twice those of log densities of the multivariate t."""
    whitening, lower = factor(1, [False])
    r = np.random.default_rng(2).normal(size=(5, C))
    cost = whitening.costs(r, np.arange(5), np.zeros(5, int), 5)
    student: Any = multivariate_t
    log = student(shape=lower @ lower.T, df=4.0).logpdf(r)
    np.testing.assert_allclose(cost - cost[0], -2 * (log - log[0]), rtol=1e-10)


def test_windows_alike_need_one_matrix():
    """A single matrix for all windows is as many copies of it."""
    own, carry = np.random.default_rng(3).normal(size=(2, 1, C, C))
    linked = np.array([False, True, True])
    r, vector, window = np.random.default_rng(4).normal(size=(3, C)), np.zeros(3, int), np.arange(3)
    one = Whitening(own, carry, linked, 5.0)
    many = Whitening(np.repeat(own, 3, 0), np.repeat(carry, 3, 0), linked, 5.0)
    np.testing.assert_allclose(one.whiten(r, vector, window), many.whiten(r, vector, window), rtol=1e-12)


def test_a_window_that_diverged_costs_the_most_and_tells_nothing():
    """Its cost is that of `DIVERGED`; the next window is whitened as if nothing stood before it."""
    whitening, _ = factor(2, [False, True])
    r = np.array([[np.nan, 1.0, 2.0], [0.3, -0.2, 0.5]])
    vector, window = np.zeros(2, int), np.arange(2)
    white = whitening.whiten(r, vector, window)
    np.testing.assert_allclose(white[1], whitening.own[1] @ r[1], rtol=1e-12)
    cost = (4.0 + C) * (np.log1p(DIVERGED / 4.0) + np.log1p((white[1] ** 2).sum() / 4.0))
    np.testing.assert_allclose(whitening.costs(r, vector, window, 1), [cost], rtol=1e-12)


def test_a_first_window_has_nothing_before_it():
    """A link is not followed where a vector's rows begin, whatever the vector before it had."""
    whitening, _ = factor(2, [False, True])
    r = np.random.default_rng(5).normal(size=(2, C))
    white = whitening.whiten(r, np.array([0, 1]), np.array([0, 1]))
    np.testing.assert_allclose(white[1], whitening.own[1] @ r[1], rtol=1e-12)


def test_shapes_that_do_not_fit():
    """Each shape is named with those it may have."""
    with pytest.raises(BadInput, match=r"carry must be of shape \(2, 3, 3\) or \(1, 3, 3\), got \(3, 3, 3\)"):
        Whitening(np.zeros((2, 3, 3)), np.zeros((3, 3, 3)), np.zeros(2, bool), 4.0)
    with pytest.raises(BadInput, match="degrees must be positive"):
        Whitening(np.zeros((2, 3, 3)), np.zeros((1, 3, 3)), np.zeros(2, bool), 0.0)


def arm():
    space = ParameterSpace([Parameter("body_mass", "lower", 0.3, 1.5)])
    return MujocoSimulator(load(DOUBLE_PENDULUM), space, nthread=1, check_influence=False)


def test_costs_of_a_simulator_are_those_of_its_residuals(monkeypatch):
    """Three vectors on windows of their own, simulated in chunks of a few rows; residuals are scaled differences."""
    sim = arm()
    windows = make_windows(sim.model, 6, 2)
    xi = np.array([[0.5], [0.9], [1.3]])
    vector, window = np.repeat([0, 1, 2], [6, 2, 3]), np.array([0, 1, 2, 3, 4, 5, 1, 2, 3, 4, 5])
    scale = np.linspace(0.5, 2.0, 8)
    rng = np.random.default_rng(6)
    own, carry = rng.normal(size=(2, 6, 8, 8))
    whitening = Whitening(own, carry, np.array(LINKS), 4.0)
    residuals = sim.residuals(xi, windows, vector, window, scale)
    predicted = sim.rollout(xi, windows, vector, window)
    np.testing.assert_array_equal(residuals, (predicted - windows.target[window]).reshape(11, 8) / scale)
    expected = whitening.costs(residuals, vector, window, 3)
    np.testing.assert_array_equal(sim.costs(xi, windows, vector, window, scale, whitening), expected)
    monkeypatch.setattr(simulator, "CHUNK_ROWS", 4)
    np.testing.assert_allclose(sim.costs(xi, windows, vector, window, scale, whitening), expected, rtol=1e-12)


def test_rows_out_of_order_and_other_windows():
    """What `costs` refuses."""
    sim = arm()
    windows = make_windows(sim.model, 2, 1)
    whitening = Whitening(np.eye(4)[None], np.zeros((1, 4, 4)), np.zeros(2, bool), 4.0)
    rows = np.array([1, 0]), np.array([0, 1])
    with pytest.raises(BadInput, match="vector must be sorted"):
        sim.costs(np.ones((2, 1)), windows, *rows, np.ones(4), whitening)
    fewer = Whitening(np.eye(4)[None], np.zeros((1, 4, 4)), np.zeros(3, bool), 4.0)
    with pytest.raises(BadInput, match="the whitening is of 3 windows, got 2"):
        sim.costs(np.ones((2, 1)), windows, np.sort(rows[0]), rows[1], np.ones(4), fewer)
    with pytest.raises(BadInput, match="scale must be 4 positive numbers"):
        sim.residuals(np.ones((2, 1)), windows, *rows, np.ones(3))
