"""The fit by trajectories on recordings of every kind: long and short, many, diverging, coarse."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import nfpde
from nfpde.errors import BadDataset
from nfpde.estimation.trajectory.freedom import widening
from tests.linear_robots import DT, SPACE, both_stages, linear_simulator, linear_step, moments

torch.set_num_threads(1)


def drifting(name, xi, rng, rows, noise=0.0):
    u = rng.normal(size=(rows, 1))
    x = np.concatenate([[[0.0]], np.cumsum(DT * (xi[0] * u[:-1] + xi[1]), axis=0)])
    return nfpde.Episode(name, DT * np.arange(rows), x + noise * rng.normal(size=x.shape), np.empty((rows, 0)), u)


def test_episodes_of_very_different_length():
    """Each robot is known as well as the length of its recording allows: errors fall with the root of it."""
    rng = np.random.default_rng(12)
    lengths = [3, 20, 2000]
    dataset = nfpde.Dataset([drifting(f"{n}", (1.0 + i, 0.5), rng, n, 0.05) for i, n in enumerate(lengths)])
    _, together = both_stages(linear_simulator(), dataset)
    widths = [np.sqrt(p.covariances[0][0, 0]) for p in together.posteriors]
    assert widths[0] > 2 * widths[1] > 4 * widths[2]
    long = SPACE.to_physical(together.posteriors[2].means[0])
    np.testing.assert_allclose(long, [3.0, 0.5], atol=0.2)


def test_windows_of_several_steps():
    """With horizon 4 the noise-free truth is found as with horizon 1, from a quarter of the windows."""
    rng = np.random.default_rng(13)
    dataset = nfpde.Dataset([drifting(f"{i}", (1.0 + i, -0.5), rng, 41) for i in range(2)])
    estimator, together = both_stages(linear_simulator(), dataset, horizon=4)
    assert [len(m) for m in estimator.problem.members] == [10, 10]
    for i, p in enumerate(together.posteriors):
        np.testing.assert_allclose(SPACE.to_physical(p.means[0]), [1.0 + i, -0.5], atol=1e-4)


def test_memory_is_bounded_without_changing_a_number(monkeypatch):
    """Simulating a few vectors at a time gives the same bits as all at once."""
    rng = np.random.default_rng(14)
    dataset = nfpde.Dataset([e for i in range(5) for e in moments(f"{i}", (1.0, 0.5), rng)])
    _, whole = both_stages(linear_simulator(), dataset)
    sizes = []
    plain = nfpde.CallableSimulator.rollout

    def watched(self, xi, windows, vector, window):
        sizes.append(len(vector))
        return plain(self, xi, windows, vector, window)

    monkeypatch.setattr("nfpde.estimation.trajectory.problem.NUMBERS_AT_ONCE", 100)
    monkeypatch.setattr(nfpde.CallableSimulator, "rollout", watched)
    _, parts = both_stages(linear_simulator(), dataset)
    # a vector of 12 windows may begin just below the limit
    assert max(sizes) <= 100 + 12 * 2
    assert parts.population.gaussians.means.tolist() == whole.population.gaussians.means.tolist()


def test_a_thousand_short_episodes():
    """Robots of three rows, some under twice the same command: a population as wide as they, from few draws each.

    Two parameters explain two windows whatever their noise: how exact the sensors are has to be said.
    """
    rng = np.random.default_rng(15)
    true = np.array([3.0, -2.0]) + 0.5 * rng.normal(size=(1000, 2))
    settings = nfpde.TrajectoryConfig(starts=1, population_rounds=1)
    dataset = nfpde.Dataset([drifting(f"{i}", xi, rng, 3) for i, xi in enumerate(true)])
    with pytest.raises(BadDataset, match=r"2000 windows .* 1000 robots, .* how exact the sensors are \(resolution"):
        nfpde.fit(linear_simulator(), dataset, config=settings, quiet=True)
    result = nfpde.fit(linear_simulator(), dataset, config=settings, resolution=1e-6, quiet=True)
    assert result.info["robots"][0]["sampling"]["draws"] < nfpde.TrajectoryConfig().draws
    # five standard errors of the mean of 1000; smoothing widens
    np.testing.assert_allclose(result.distribution.mean(), true.mean(0), atol=5 * 0.5 / np.sqrt(1000))
    assert (result.distribution.std() > 0.8 * true.std(0)).all()
    assert (result.distribution.std() < 1.5 * true.std(0)).all()


def test_resolution_is_the_floor_of_the_noise():
    """Sensors that show steps of 0.01 leave no smaller errors than their rounding, as the standard errors show."""
    rng = np.random.default_rng(16)
    episodes = [drifting("a", (1.0, 0.5), rng, 40)]
    fine, _ = both_stages(linear_simulator(), nfpde.Dataset(episodes))
    coarse, rounded = both_stages(linear_simulator(), nfpde.Dataset(episodes), resolution=0.01)
    unit = coarse.problem.unit[0]
    assert np.exp(fine.alone.noise.log_scale) < 1e-8
    # rounded at both ends, each row at the end of one transition and at the start of the next
    covariance = 0.01**2 / 12 * (2 * np.eye(39) - np.eye(39, k=1) - np.eye(39, k=-1))
    typical = np.exp(np.linalg.slogdet(covariance)[1] / 2 / 39)
    assert np.exp(coarse.alone.noise.log_scale) * unit == pytest.approx(typical, rel=1e-6)
    design = DT * np.column_stack([episodes[0].ctrl[:-1, 0], np.ones(39)])
    # the exact covariance of least squares with that noise, seen in z: slope of the box at the mode
    (p,) = rounded.posteriors
    slope = np.diag(SPACE.width * 0.25 * (1 - np.tanh(p.means[0] / 2) ** 2))
    # 39 windows less two parameters tell it
    assert coarse.alone.noise.scatter.freedom == pytest.approx(37, abs=0.1)
    closed = widening(37) * np.linalg.inv(design.T @ np.linalg.solve(covariance, design))
    np.testing.assert_allclose(slope @ p.covariances[0] @ slope, closed, rtol=0.02, atol=0.02 * closed.max())


@pytest.mark.parametrize("wrong", [-1.0, np.nan, [0.1, 0.1], "fine"])
def test_wrong_resolutions_are_refused(wrong):
    """Negative, not finite, or not one for each channel: the channels are named."""
    rng = np.random.default_rng(17)
    dataset = nfpde.Dataset([drifting("a", (1.0, 0.5), rng, 10)])
    with pytest.raises(nfpde.NfpdeError, match=r"resolution must be .* the 1 channels \(qpos x\), none negative; got"):
        nfpde.fit(linear_simulator(), dataset, resolution=wrong, quiet=True)
    with pytest.raises(nfpde.NfpdeError, match="resolution means nothing to the method softmax"):
        nfpde.fit(linear_simulator(), dataset, method="softmax", resolution=0.1, quiet=True)


def test_a_simulator_that_always_diverges_is_refused():
    """No parameters explain anything: an error that says so, and no distribution."""
    rng = np.random.default_rng(18)
    broken = nfpde.CallableSimulator(lambda x, u, xi: np.full_like(x, np.nan), SPACE, positions=["x"])
    dataset = nfpde.Dataset([drifting("a", (1.0, 0.5), rng, 10)])
    with pytest.raises(nfpde.NfpdeError, match="every simulation of the recordings diverged, from 4 starting points"):
        nfpde.fit(broken, dataset, quiet=True)


@pytest.mark.parametrize("whole", [False, True])
def test_moments_that_always_diverge(whole, tmp_path):
    """One such moment takes no part and does no harm, nor to what is saved; a robot of nothing else is an error."""
    rng = np.random.default_rng(20)
    good, bad = drifting("good", (1.0, 0.5), rng, 20), drifting("bad", (2.0, -0.5), rng, 20)
    cursed = bad.qpos if whole else bad.qpos[4:5]

    def step(x, u, xi):
        return np.where(np.isin(x, cursed), np.nan, linear_step(x, u, xi))

    simulator = nfpde.CallableSimulator(step, SPACE, positions=["x"])
    dataset = nfpde.Dataset([replace(good, qpos=good.qpos + 0.25), bad])
    if whole:
        with pytest.raises(nfpde.NfpdeError, match="every simulation of the recordings of episode bad diverged"):
            nfpde.fit(simulator, dataset, out=tmp_path, quiet=True)
    else:
        robots = nfpde.fit(simulator, dataset, out=tmp_path, quiet=True).info["robots"]
        assert robots[1]["diverged"] == 1
        assert robots[0]["diverged"] == 0
        assert robots[1]["parameters"]["gain"]["value"] == pytest.approx(2.0, abs=1e-4)
