"""Velocities that share the positions' errors, and noise that passes for errors of the simulation."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import nfpde
from nfpde.benchmarks import collect, robot
from nfpde.benchmarks.hidden import hide
from nfpde.dataset import Dataset, differentiate_episode
from nfpde.dataset.velocities import COMPUTED, computed_velocities
from nfpde.errors import BadInput
from nfpde.estimation.trajectory.chains import Chains
from nfpde.estimation.trajectory.estimator import TrajectoryEstimator
from nfpde.estimation.trajectory.foretold import foretold, surely_better
from nfpde.estimation.trajectory.noise import Scatter
from nfpde.estimation.trajectory.problem import make_problem
from nfpde.estimation.trajectory.scatter import sensors_alone, simulation_errs
from nfpde.sim import load_model

torch.set_num_threads(1)
PENDULUM = robot("pendulum")
NOISE, LARGE = 0.01, 0.03
"""Of the angle [rad]: half a degree, and two."""


def simulator():
    return nfpde.MujocoSimulator(PENDULUM.path, PENDULUM.space)


def recorded(velocities, effects=(), noise=NOISE):
    """Three episodes of one pendulum under commands that change in every step, its angles noisy, and the truth."""
    data, truth = collect(PENDULUM, "gaussian", episodes=3, robots=1, seed=1, effects=effects)
    rng, dt = np.random.default_rng(2), data.control_dt
    episodes = []
    for e in data:
        noisy = replace(e, qpos=e.qpos + noise * rng.normal(size=e.qpos.shape))
        episodes.append(replace(noisy, qvel=velocities(noisy, e.qvel, dt, rng, noise)))
    return Dataset(episodes), truth.xi[0, : len(PENDULUM.space)]


def measured(noisy, qvel, dt, rng, noise):
    """By a sensor of their own, as noisy as differences of the angles are."""
    return qvel + noise / dt / np.sqrt(2) * rng.normal(size=qvel.shape)


def central(noisy, qvel, dt, rng, noise):
    return differentiate_episode(noisy).qvel


def filtered(noisy, qvel, dt, rng, noise):
    """As servos report them: backward differences behind a low-pass filter of 10 rad/s."""
    raw = np.diff(noisy.qpos, axis=0, prepend=noisy.qpos[:1]) / dt
    out = raw.copy()
    for k in range(1, len(out)):
        out[k] = out[k - 1] + (1 - np.exp(-10 * dt)) * (raw[k] - out[k - 1])
    return out


def fitted(data):
    result = nfpde.fit(simulator(), data, quiet=True)
    (found,) = result.info["robots"]
    return result, *(np.array([p[name] for p in found["parameters"].values()]) for name in ("value", "std"))


@pytest.mark.parametrize("velocities", [measured, central, filtered])
def test_a_pendulum_is_found_whatever_its_velocities_are(velocities):
    """The truth lies within four standard deviations, and these are small: of the mass, and of the damping.

    Differences of positions lag, lead and blur what commands do within a step: believed as they are, they tell a mass
    twice too large, to a few per cent.
    """
    data, truth = recorded(velocities, noise=LARGE)
    result, value, std = fitted(data)
    assert (np.abs(value - truth) < 4 * std).all()
    assert (std < 0.05 * PENDULUM.space.width).all()
    words = " ".join(result.info["cautions"])
    assert ("computed from positions, which tell all" in words) == (velocities is central)
    assert ("The recorded velocities foretell the positions worse" in words) == (velocities is filtered)
    assert "Something is missing" not in words


def test_good_velocities_cost_no_second_search():
    """Where the sensors explain all, there is nothing to doubt."""
    estimator = TrajectoryEstimator(make_problem(simulator(), recorded(measured)[0], 1), nfpde.TrajectoryConfig(), 0)
    while not estimator.done:
        estimator.step()
    assert (estimator.doubts, estimator.loose) == (0, False)


def test_a_missing_effect_stays_an_error_of_the_simulation():
    """Friction that the model lacks is in the pendulum, not in its sensors, and the result says where to go."""
    friction = hide(load_model(PENDULUM.path), "coulomb_friction", torque=0.3)
    data, _ = recorded(measured, [friction])
    result, *_ = fitted(data)
    (words,) = result.info["cautions"]
    assert words.startswith("Something is missing in the model that no parameter makes up for")
    assert "nfpde diagnose" in words
    assert "qvel hinge" in words


@pytest.mark.parametrize("method", ["softmax", "cai"])
def test_methods_that_start_from_computed_velocities_refuse_them(method, monkeypatch):
    """Whether the numbers show them or the recordings say so, by name, with what to do; measured ones they take."""
    data, _ = recorded(central)
    words = (
        f"qvel hinge: computed from positions, and the method {method} starts every transition from the recorded "
        r"velocities: take trajectory, which believes the positions alone%s, or record velocities"
    )
    few = nfpde.NfpdeConfig(iterations=1, samples=8)
    with pytest.raises(BadInput, match=words % ""):
        nfpde.fit(simulator(), data, method=method, config=few, quiet=True)
    data, _ = recorded(measured)
    nfpde.fit(simulator(), data, method=method, config=few, quiet=True)
    said = replace(data, metadata=replace(data.metadata, conventions=COMPUTED))
    with pytest.raises(BadInput, match=words % ""):
        nfpde.fit(simulator(), said, method=method, config=few, quiet=True)
    several = simulator()
    monkeypatch.setattr(several, "jumps", (0,))
    with pytest.raises(BadInput, match=words % r" \(each model by a simulator of its own\)"):
        nfpde.fit(several, said, method=method, config=few, quiet=True)


def test_a_doubt_that_was_interrupted_goes_on_to_the_same_numbers():
    """State and restore after every round, with an answer kept for comparison, against a run that never stopped."""
    problem, config = make_problem(simulator(), recorded(filtered, noise=LARGE)[0], 1), nfpde.TrajectoryConfig()
    whole, parts = (TrajectoryEstimator(problem, config, 0) for _ in range(2))
    while not whole.done:
        whole.step()
    kept = 0
    while not parts.done:
        parts.step()
        tensors, info = parts.state()
        kept += info["rival"] is not None
        parts = TrajectoryEstimator(problem, config, 0)
        parts.restore(tensors, json.loads(json.dumps(info)))
    assert kept > 1
    assert parts.loose
    for a, b in zip(whole.posteriors(), parts.posteriors(), strict=True):
        assert a.means.tolist() == b.means.tolist()
        assert a.covariances.tolist() == b.covariances.tolist()


def test_what_is_foretold_is_a_conditional_density():
    """Of positions, given all earlier residuals: from the dense covariance of a chain of four windows."""
    rng, n, ndiff = np.random.default_rng(3), 4, 3
    slopes, root = rng.normal(size=(n, ndiff, ndiff)), rng.normal(size=(ndiff, ndiff))
    scatter = Scatter(rng.uniform(0.5, 2.0, ndiff), 0.3 * root @ root.T, scale=1.3)
    residuals = 0.5 * rng.normal(size=(n, ndiff))
    positions = np.array([True, False, True])
    covariance = np.zeros((n * ndiff, n * ndiff))
    own, shared = scatter.covariances(slopes)
    for t in range(n):
        rows = slice(t * ndiff, (t + 1) * ndiff)
        covariance[rows, rows] = own[t]
        if t:
            before = slice((t - 1) * ndiff, t * ndiff)
            covariance[rows, before], covariance[before, rows] = shared[t], shared[t].T
    covariance *= scatter.scale

    def log_density(rows):
        part, r = covariance[np.ix_(rows, rows)], residuals.ravel()[rows]
        return -0.5 * (np.linalg.slogdet(2 * np.pi * part)[1] + r @ np.linalg.solve(part, r))

    told = 0.0
    for t in range(n):
        earlier, now = np.arange(t * ndiff), t * ndiff + np.flatnonzero(positions)
        told += log_density(np.concatenate([earlier, now])) - (log_density(earlier) if t else 0.0)
    chains = Chains.of(np.array([False, True, True, True]))
    # a million degrees of freedom stand for a Gaussian, rounding a share of 1e-13 of the variances
    found = foretold(scatter, chains, slopes, residuals, positions)
    assert found.sum() == pytest.approx(told, abs=1e-4)
    assert np.isnan(
        foretold(scatter, chains, slopes, np.where(np.arange(4)[:, None] == 2, np.nan, residuals), positions)[2]
    )


def test_chance_and_few_windows_are_not_believed():
    """As good in the mean is not better, nor are 19 windows; a clear difference in 20 is, whatever one outlier says."""
    rng = np.random.default_rng(5)
    one = rng.normal(size=400)
    assert not surely_better(one, rng.permutation(one))
    assert not surely_better(one[:19] + 1.0, one[:19])
    assert surely_better(one[:20] + 1.0, one[:20])
    assert not surely_better(np.where(np.arange(400) == 0, one + 500.0, one - 0.1), one)


def test_noise_of_the_sensors_alone_leaves_as_much():
    """The median variance of every channel stays, next to nothing of it is the simulation's, and floors hold."""
    slopes = np.broadcast_to(np.array([[1.0, 0.1], [-0.2, 0.9]]), (30, 2, 2))
    scatter = Scatter(np.array([1e-6, 1e-6]), np.diag([0.3, 0.2]), scale=0.5)
    alone = sensors_alone(scatter, slopes, (np.zeros(2), np.full(2, 1e-9)))
    before, after = (s.scale * s.covariances(slopes)[0][0] for s in (scatter, alone))
    # each channel's errors reach the other, too: not more than twice, not less than half
    assert (np.diag(after) < 2 * np.diag(before)).all()
    assert (np.diag(after) > 0.5 * np.diag(before)).all()
    assert simulation_errs(scatter, slopes)
    assert not simulation_errs(alone, slopes)
    held = sensors_alone(scatter, slopes, (np.array([0.0, 7.0]), np.full(2, 1e-9)))
    assert held.sensor[1] == 49.0


def test_velocities_that_nobody_measured_are_known():
    """By what the data set says, or to the last digits; of noisy or resampled ones only what it says."""
    data, _ = recorded(central)
    axes = simulator().states.axes
    assert axes == [(0, 0)]
    assert computed_velocities(data, axes).tolist() == [0]
    noisy, _ = recorded(measured)
    assert computed_velocities(noisy, axes).tolist() == []
    said = Dataset(noisy.episodes, metadata=replace(noisy.metadata, conventions=COMPUTED))
    assert computed_velocities(said, ()).tolist() == [0]
