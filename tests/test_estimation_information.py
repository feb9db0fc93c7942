"""Information about some combinations of parameters and none about others, in double precision."""

import numpy as np
import pytest

import nfpde
from nfpde.estimation.trajectory.compete import untold
from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.identify import Knowledge
from nfpde.estimation.trajectory.information import inverse, standard_errors, without_rounding
from nfpde.estimation.trajectory.likelihood import Quadratic
from nfpde.estimation.trajectory.modes import LocalPosterior

PRIOR = 0.5
"""Information of the uniform box at z = 0."""


def told(*directions):
    """Information (D, D) of directions that are known to 1 / their length each."""
    rows = np.array(directions, float)
    return rows.T @ rows


def turned(d, sharp, rng):
    """Information in which a random plane is told by `sharp`, nothing else, and the projector on what is flat."""
    basis = np.linalg.qr(rng.normal(size=(d, d)))[0]
    plane = basis[:, :2]
    return sharp**2 * plane @ plane.T, basis[:, 2:] @ basis[:, 2:].T


@pytest.mark.parametrize("sharp", [1e2, 1e5, 1e9, 1e12])
@pytest.mark.parametrize("seed", range(3))
def test_flat_directions_stay_flat(sharp, seed):
    """What is flat keeps the prior's variance to 1 %, however sharp the rest is; the rest stays sharp."""
    rng = np.random.default_rng(seed)
    information, flat = turned(5, sharp, rng)
    covariance = inverse(without_rounding(information) + PRIOR * np.eye(5))
    np.testing.assert_allclose(np.trace(flat @ covariance), 3 / PRIOR, rtol=0.01)
    np.linalg.cholesky(covariance)
    rest = np.eye(5) - flat
    # known at least to 1e-3, where the prior leaves 1.4
    assert np.trace(rest @ covariance @ rest) < 2 * max(1e-3, 1 / sharp) ** 2


def test_what_the_flat_direction_does_not_touch_keeps_its_sharpness():
    information = told([3e10, 4e10, 0, 0], [0, 0, 2e9, 0], [0, 0, 1e9, 3e9])
    cleaned = without_rounding(information)
    np.testing.assert_allclose(cleaned[2:, 2:], information[2:, 2:], rtol=1e-9)
    np.testing.assert_allclose(cleaned[:2, 2:], 0.0, atol=1e-3)
    assert np.array([4.0, -3.0]) @ cleaned[:2, :2] @ np.array([4.0, -3.0]) < 1e-3 * PRIOR
    assert 1e6 < np.trace(cleaned[:2, :2]) < 1e10


def test_unequal_sizes_need_no_softening():
    """z_1 known to 1e-10 but for 1e-8 of z_2, which nothing tells: all of it fits into double precision."""
    cleaned = without_rounding(told([1e10, 1e2]))
    np.testing.assert_allclose(cleaned, told([1e10, 1e2]), rtol=1e-9)


def test_without_flat_directions_nothing_changes():
    information = told([1e10, 0, 0], [1e9, 1e9, 0], [0.0, 0.0, 1e-3])
    assert without_rounding(information) is information


def test_standard_errors_by_hand():
    """Of a sum, a single one and one that nothing tells: with errors only where nothing flat takes part."""
    information = told([1e10, 1e10, 0, 0], [0, 0, 1e3, 0])
    np.testing.assert_allclose(standard_errors(information), [np.inf, np.inf, 1e-3, np.inf])
    np.testing.assert_allclose(standard_errors(told([1e10, 0], [1e2, 1e2])), [1e-10, 1e-2], rtol=1e-6)
    assert np.isinf(standard_errors(np.zeros((2, 2)))).all()


def test_products_with_populations_are_distributions():
    """A robot's quadratic likelihood, flat in one direction, times a population: the population's own width there."""
    rng = np.random.default_rng(3)
    information, flat = turned(4, 1e11, rng)
    fisher = without_rounding(information)
    robot = LocalPosterior(np.ones(1), np.zeros((1, 4)), inverse(fisher + PRIOR * np.eye(4))[None], fisher[None])
    population = Gaussians(np.ones(1), np.ones((1, 4)), 0.04 * np.eye(4)[None])
    posterior = Quadratic.of(robot).times(population)
    np.testing.assert_allclose(flat @ posterior.covariances[0] @ flat, 0.04 * flat, atol=1e-6)
    assert np.isfinite(posterior.log_density(posterior.sample(10, rng))).all()


def test_clean_recordings_of_a_sum_do_not_tell_its_parts():
    """Two masses that act as one, recorded without noise: a known sum leaves each the prior's error over root two."""
    space = nfpde.ParameterSpace([nfpde.Parameter("body_mass", n, low=1.0, high=3.0) for n in ("a", "b")])
    fisher = without_rounding(told([3e9, 3e9]) * (1 + 1e-15))
    known = Knowledge.of(space, LocalPosterior(np.ones(1), np.zeros((1, 2)), np.zeros((1, 2, 2)), fisher[None]))
    np.testing.assert_allclose(known.std, 2 / np.sqrt(12) / np.sqrt(2), rtol=1e-6)
    assert known.pairs()[0]["correlation"] < -0.999
    assert "known to" in known.pairs()[0]["words"]


def test_untold_is_what_is_wider_than_the_modes_lie_apart():
    """One direction is told by both robots, one by neither, one by the second alone."""
    precise = [np.diag([1e6, PRIOR, PRIOR]), np.diag([1e6, PRIOR, 1e6])]
    robots = [LocalPosterior(np.ones(1), np.zeros((1, 3)), inverse(p)[None], p[None]) for p in precise]
    spread = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(untold(robots, spread), np.diag([0.0, 1 / PRIOR - 0.2**2, 0.0]), atol=1e-9)
