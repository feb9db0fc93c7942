"""Residuals and costs of whole recordings on Warp's CPU device, against their twins in double precision."""

import numpy as np
import pytest

from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import Whitening
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.whitening import DIVERGED
from tests.device import WARP
from tests.models import BALL, DOUBLE_PENDULUM, PENDULUM, load, make_windows

LINKS = np.array([False, True, True, False, True, False, True])
ROWS = np.repeat([0, 1, 3], [7, 2, 4]), np.array([0, 1, 2, 3, 4, 5, 6, 1, 2, 3, 4, 5, 6])
XI = np.array([[0.5], [0.9], [1.0], [1.3]])
HORIZON = 3

# Windows of a few units, nine physics steps in single precision: 1e-5 in the states, as test_warp has it
TOLERANCE = 5e-5


def arm(**options):
    space = ParameterSpace([Parameter("body_mass", "lower", 0.3, 1.5)])
    return WarpSimulator(load(DOUBLE_PENDULUM), space, device=WARP, check_influence=False, **options)


@pytest.fixture(scope="module")
def sim():
    return arm()


def chained(n, channels, seed=0, degrees=4.0):
    rng = np.random.default_rng(seed)
    own = np.tril(rng.normal(size=(n, channels, channels))) / channels + np.eye(channels)
    return Whitening(own, 0.3 * rng.normal(size=own.shape), LINKS, degrees)


def poisoned(sim, call):
    """The second answer, with every buffer full of NaN before it."""
    call()
    for batch in sim._batches.kept.values():
        batch.poison()
    return call()


def test_residuals_are_their_twins(sim):
    """Scaled differences of all channels and steps, of rows with their own vector and window."""
    windows = make_windows(sim.model, 7, HORIZON, nsub=3)
    scale = np.linspace(0.5, 2.0, 12)
    found = poisoned(sim, lambda: sim.residuals(XI, windows, *ROWS, scale))
    np.testing.assert_allclose(found, sim.reference.residuals(XI, windows, *ROWS, scale), atol=TOLERANCE / 0.5)


def test_residuals_of_rotations():
    """A quaternion's four numbers make three channels, at the same places as in the twin."""
    field = Parameter("opt.gravity", None, -11.0, -9.0, component=2)
    sim = WarpSimulator(load(BALL), ParameterSpace([field]), device=WARP, check_influence=False)
    windows = make_windows(sim.model, 5, 2, spread=1.5)
    scale = np.linspace(0.5, 2.0, 2 * sim.states.ndiff)
    rows = np.zeros(5, int), np.arange(5)
    found = sim.residuals(np.array([[-10.0]]), windows, *rows, scale)
    expected = sim.reference.residuals(np.array([[-10.0]]), windows, *rows, scale)
    np.testing.assert_allclose(found, expected, atol=TOLERANCE / 0.5)


@pytest.mark.parametrize("degrees", [2.5, 1e6])
def test_costs_are_their_twins(sim, degrees):
    """Chains of two and three windows, vectors on parts of them, one vector without rows; heavy tails and none."""
    windows = make_windows(sim.model, 7, HORIZON, nsub=3)
    scale, whitening = np.linspace(0.5, 2.0, 12), chained(7, 12, degrees=degrees)
    found = poisoned(sim, lambda: sim.costs(XI, windows, *ROWS, scale, whitening))
    expected = sim.reference.costs(XI, windows, *ROWS, scale, whitening)
    assert expected[2] == 0
    # relative errors of residuals of about one
    np.testing.assert_allclose(found, expected, rtol=10 * TOLERANCE)


def test_costs_of_the_same_residuals_differ_by_rounding_only(sim):
    """What the device makes of its own residuals is what numpy makes of them in double precision."""
    windows = make_windows(sim.model, 7, HORIZON, nsub=3)
    scale, whitening = np.ones(12), chained(7, 12)
    residuals = sim.residuals(XI, windows, *ROWS, scale)
    expected = whitening.costs(residuals, *ROWS, 4)
    np.testing.assert_allclose(sim.costs(XI, windows, *ROWS, scale, whitening), expected, rtol=1e-12)


def test_costs_in_batches_that_split_a_recording(sim):
    """A few worlds at once: the innovation before a cut is carried over it."""
    windows = make_windows(sim.model, 7, HORIZON, nsub=3)
    scale, whitening = np.ones(12), chained(7, 12)
    expected = sim.costs(XI, windows, *ROWS, scale, whitening)
    for nworld in (1, 3, 4):
        np.testing.assert_allclose(arm(nworld=nworld).costs(XI, windows, *ROWS, scale, whitening), expected, rtol=1e-12)


def test_windows_alike_share_a_matrix(sim):
    """One matrix for all windows, and a small cost: nothing is lost in log(1 + x)."""
    windows = make_windows(sim.model, 7, HORIZON)
    whitening = Whitening(1e-9 * np.eye(12)[None], np.zeros((1, 12, 12)), LINKS, 4.0)
    found = sim.costs(XI, windows, *ROWS, np.ones(12), whitening)
    squares = np.bincount(ROWS[0], (sim.residuals(XI, windows, *ROWS, np.ones(12)) ** 2).sum(1), 4)
    # log(1 + x) is x to x / 2, and x is 1e-17 here
    np.testing.assert_allclose(found, (4 + 12) * 1e-18 * squares / 4, rtol=1e-12)


def test_a_simulation_that_diverged():
    """NaN from the step on in which it did, the cost of `DIVERGED`, and nothing told to the window after it."""
    space = ParameterSpace([Parameter("jnt_stiffness", "hinge", -1e6, 1.0)])
    sim = WarpSimulator(load(PENDULUM), space, device=WARP, check_influence=False)
    windows = make_windows(sim.model, 7, 20)
    xi, channels = np.array([[0.5], [-1e6]]), 40
    rows = np.repeat([0, 1], 7), np.tile(np.arange(7), 2)
    residuals = sim.residuals(xi, windows, *rows, np.ones(channels))
    gone = np.isnan(residuals[7:])
    assert gone[:, -1].all()
    assert not gone[:, 0].any()
    assert np.isfinite(residuals[:7]).all()
    whitening = chained(7, channels)
    cost = sim.costs(xi, windows, *rows, np.ones(channels), whitening)
    np.testing.assert_allclose(cost, whitening.costs(residuals, *rows, 2), rtol=1e-12)
    np.testing.assert_allclose(cost[1], 7 * (4 + channels) * np.log1p(DIVERGED / 4), rtol=1e-12)


def test_counts_its_steps(sim):
    """Residuals and costs are simulations like any other."""
    windows = make_windows(sim.model, 7, HORIZON, nsub=2)
    before = sim.simulated_steps
    sim.residuals(XI, windows, *ROWS, np.ones(12))
    sim.costs(XI, windows, *ROWS, np.ones(12), chained(7, 12))
    assert sim.simulated_steps - before == 2 * 13 * HORIZON * 2
