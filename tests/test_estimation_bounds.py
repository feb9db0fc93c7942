"""Posteriors that lean on a bound, against the exact ones by quadrature."""

import numpy as np
import pytest
from scipy.special import expit

import nfpde
from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.levenberg import FARTHEST, improve, linearise, start
from nfpde.estimation.trajectory.likelihood import Quadratic
from nfpde.estimation.trajectory.modes import local_posteriors
from nfpde.estimation.trajectory.noise import Noise, Scatter
from nfpde.estimation.trajectory.pool import Pool, box_log_density
from nfpde.estimation.trajectory.problem import make_problem
from nfpde.estimation.trajectory.sampling import widened

SPACE = nfpde.ParameterSpace([nfpde.Parameter("gain", low=0.0, high=1.0)])
GRID = np.linspace(-30.0, 50.0, 80_001)
STEP = GRID[1] - GRID[0]
ROWS = 30


def pushed(gain, noise):
    """A robot's problem, its noise, its posterior and the log of the exact one on the grid, up to a constant."""
    simulator = nfpde.CallableSimulator(lambda x, u, xi: x + 0.1 * xi * u, SPACE, ["x"])
    rows = np.arange(ROWS)[:, None]
    episode = nfpde.Episode("a", 0.1 * rows[:, 0], 0.1 * gain * rows, np.empty((ROWS, 0)), np.ones((ROWS, 1)))
    problem = make_problem(simulator, nfpde.Dataset([episode]), 1)
    known = Noise.alike(Scatter(np.zeros(0), np.diag((noise / problem.unit) ** 2)), problem.members)
    c = start(problem, np.array([[0.5]]), np.array([0]), known)
    improve(problem, c, known, 100)
    linearise(problem, c, known, np.array([0]), careful=True)
    # beyond the farthest place nothing is simulated: a likelihood counts there as it is at that place
    squares = (ROWS - 1) * ((expit(np.clip(GRID, -FARTHEST, FARTHEST)) - gain) * 0.1 / noise) ** 2
    return problem, known, local_posteriors(c, 1)[0], box_log_density(GRID[:, None]) - 0.5 * squares


@pytest.mark.parametrize(
    ("gain", "noise"), [(0.5, 10.0), (0.9, 0.01), (0.9, 0.5), (1.05, 0.01), (1.3, 0.02), (1.3, 0.005), (-0.2, 0.02)]
)
def test_a_mode_is_as_wide_as_its_curvature_says(gain, noise):
    """Not told, told well inside, and pushed against either bound: the variance is one over the exact curvature."""
    _, _, found, exact = pushed(gain, noise)
    top = int(exact.argmax())
    curvature = -(exact[top + 20] - 2 * exact[top] + exact[top - 20]) / (20 * STEP) ** 2
    np.testing.assert_allclose(found.means[0, 0], GRID[top], atol=0.01)
    np.testing.assert_allclose(found.covariances[0, 0, 0], 1 / curvature, rtol=0.01)
    # the quadratic likelihood times the logistic prior is as wide
    z = found.means[0] + np.array([[-1e-3], [0.0], [1e-3]])
    logs = Quadratic.of(found).log_likelihood(z) + box_log_density(z)
    np.testing.assert_allclose(-(logs[0] - 2 * logs[1] + logs[2]) / 1e-6, curvature, rtol=0.01)


def test_draws_near_a_bound_count_with_their_own_density():
    """Quantiles of weighted draws are those of the exact posterior, a third of which lies beyond the farthest mode.

    The simulation no longer changes there, and a draw may not be put where its density is another one.
    """
    problem, noise, found, exact = pushed(1.0001, 3.7e-7)
    pool = Pool.empty(1, 1)
    proposal = widened(Gaussians(found.weights, found.means, found.covariances))
    pool.add(problem, noise, [proposal], 40_000, np.random.default_rng(0))
    ratios = pool.ratios([Quadratic.of(found)], 10.0)
    assert ratios.sampled[0]
    z, weights = ratios.z[0, :, 0], ratios.box_weights(0)
    assert np.isin(z, (-FARTHEST, FARTHEST)).sum() == 0
    order, density = z.argsort(), np.exp(exact - exact.max())
    below, expected = np.cumsum(weights[order]), np.cumsum(density / density.sum())
    assert expected[np.searchsorted(GRID, FARTHEST)] < 0.7
    effective = weights.sum() ** 2 / (weights**2).sum()
    assert effective > 2000
    for share in (0.05, 0.5, 0.9):
        there = z[order][np.searchsorted(below, share)]
        error = np.sqrt(share * (1.0 - share) / effective)
        np.testing.assert_allclose(np.interp(there, GRID, expected), share, atol=4.0 * error)
