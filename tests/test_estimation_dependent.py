"""Windows of several steps: residuals that are the same but for rounding, and covariances that fill the memory."""

import numpy as np
import pytest

import nfpde
from nfpde.errors import BadDataset
from nfpde.estimation.trajectory.components import _riccati, at_least, definite
from nfpde.estimation.trajectory.problem import make_problem
from nfpde.estimation.trajectory.scatter import learn_alike

DT = 0.01


def near_singular(rng, channels, decades):
    """A covariance whose eigenvalues fall over so many decades from one."""
    turns = np.linalg.qr(rng.normal(size=(channels, channels)))[0]
    return (turns * np.logspace(0, -decades, channels)) @ turns.T


def test_a_sound_covariance_stays_as_it_is():
    """Correlations that double precision holds, and channels of whatever sizes, are given back to the last bit."""
    rng = np.random.default_rng(0)
    sound, sizes = near_singular(rng, 4, 10), np.array([1e-9, 1e-3, 1.0, 1e6])
    assert definite(sound) is sound
    assert np.array_equal(definite(np.diag(sizes**2)), np.diag(sizes**2))
    np.testing.assert_allclose(at_least(np.diag(sizes**2), np.full(4, 1e-9)), np.diag(sizes**2), rtol=1e-12)


def test_a_singular_covariance_gets_a_factor():
    """No direction is lifted by more than the share that is rounding, and Cholesky's factor is there."""
    rng = np.random.default_rng(1)
    sizes = np.logspace(-6, 3, 4)
    singular = near_singular(rng, 4, 18) * np.outer(sizes, sizes)
    for found in (definite(singular), at_least(singular, np.full(4, 1e-15))):
        lower = np.linalg.cholesky(found)
        np.testing.assert_allclose(lower @ lower.T, found, rtol=1e-12)
        own = np.sqrt(np.diag(singular))
        np.testing.assert_allclose(found / np.outer(own, own), singular / np.outer(own, own), atol=1e-11)


@pytest.mark.parametrize("decades", [1, 6])
def test_a_step_of_a_full_covariance_solves_its_equation(decades):
    """X expected X = process shown process, and X is positive definite."""
    rng = np.random.default_rng(decades)
    process, shown, expected = (near_singular(rng, 5, decades) for _ in range(3))
    found = _riccati(process, shown, expected)
    right = process @ shown @ process
    np.testing.assert_allclose(found @ expected @ found, right, atol=1e-7 * np.abs(right).max())
    assert np.linalg.eigvalsh(found)[0] > 0


def test_noise_of_dependent_channels_has_a_factor():
    """Two channels that are the same but for 1e-9 of them, whose square is lost beside one."""
    rng = np.random.default_rng(2)
    first = rng.normal(size=(200, 1))
    residuals = np.hstack([first, first + 1e-9 * rng.normal(size=(200, 1)), rng.normal(size=(200, 1))])
    process = learn_alike([residuals], 0, np.full(3, 1e-9)).process
    np.testing.assert_allclose(np.diag(process), (residuals**2).mean(0), rtol=0.3)
    np.linalg.cholesky(process)


def pendulum_step(x, u, xi):
    v = x[:, 1] + DT * (10 * u[:, 0] * xi[:, 0] - 5 * np.sin(x[:, 0]))
    return np.stack([x[:, 0] + DT * v, v], 1)


@pytest.mark.parametrize("seed", [1, 2])
def test_windows_of_clean_smooth_recordings_are_fitted(seed):
    """Of several robots the gains come out as they were, with windows of two steps that say nearly the same."""
    rng = np.random.default_rng(seed)
    space = nfpde.ParameterSpace([nfpde.Parameter("gain", low=0.5, high=2.0)])
    simulator, episodes, gains = nfpde.CallableSimulator(pendulum_step, space, ["q"], ["v"]), [], []
    for k in range(3):
        gains.append(space.uniform(1, rng))
        u, rows = rng.uniform(-1, 1, (30, 1)), [rng.normal(size=(1, 2))]
        for t in range(29):
            rows.append(pendulum_step(rows[-1], u[t : t + 1], gains[-1]))
        x = np.concatenate(rows)
        episodes.append(nfpde.Episode(f"{k}", DT * np.arange(30), x[:, :1], x[:, 1:], u))
    config = nfpde.TrajectoryConfig(horizon=2)
    result = nfpde.fit(simulator, nfpde.Dataset(episodes), config=config, quiet=True)
    found = [robot["parameters"]["gain"]["value"] for robot in result.info["robots"]]
    np.testing.assert_allclose(found, np.ravel(gains), rtol=1e-5)


def test_recordings_that_memory_cannot_hold_are_refused(monkeypatch):
    """Before anything is simulated, with the numbers and what to do; 29 windows of 2 channels are 13 matrices each.

    Beside them are 4 columns for the only parameter.
    """
    needed = 29 * (13 * 4 + 4 * 2) * 8
    space = nfpde.ParameterSpace([nfpde.Parameter("gain", low=0.5, high=2.0)])
    simulator = nfpde.CallableSimulator(pendulum_step, space, ["q"], ["v"])
    rows = np.arange(30.0)[:, None]
    dataset = nfpde.Dataset([nfpde.Episode("a", DT * rows[:, 0], rows, rows, rows)])
    problem = make_problem(simulator, dataset, 1)
    monkeypatch.setattr("nfpde.estimation.trajectory.problem.memory", lambda: needed)
    problem.check_memory()
    monkeypatch.setattr("nfpde.estimation.trajectory.problem.memory", lambda: needed - 1)
    with pytest.raises(BadDataset, match=r"29 windows of 2 numbers each need about .* shorten the horizon"):
        nfpde.fit(simulator, dataset, quiet=True)
    assert simulator.simulated_steps == 0
