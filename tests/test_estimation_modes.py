"""Robots that several parameter vectors explain alike, and what tells one noise from another."""

import json
from dataclasses import replace

import numpy as np
import torch
from scipy.stats import multivariate_t

import nfpde
from nfpde.estimation.trajectory.estimator import TrajectoryEstimator
from nfpde.estimation.trajectory.levenberg import reweigh
from nfpde.estimation.trajectory.noise import Noise
from nfpde.estimation.trajectory.problem import make_problem
from nfpde.estimation.trajectory.stages import TwoStages

torch.set_num_threads(1)

DT, ROWS = 0.05, 60
SPACE = nfpde.ParameterSpace([nfpde.Parameter("place", low=-3.0, high=3.1), nfpde.Parameter("rate", low=0.0, high=2.0)])


def swing(x, u, xi):
    """A pendulum that shows only the square of its place, and a damping."""
    q, v = x[:, :1], x[:, 1:]
    return np.hstack([q + DT * v, v + DT * (u - xi[:, :1] ** 2 * np.sin(q) - xi[:, 1:] * v)])


def two_modes(robots, horizon=1):
    """The windows of robots at places around -2 or 2."""
    rng, episodes = np.random.default_rng(0), []
    for g in range(robots):
        xi = np.array([[2 + 0.1 * rng.normal(), 0.5 + 0.1 * rng.normal()]])
        rows, u = [rng.normal(size=(1, 2))], 2 * rng.normal(size=(ROWS, 1))
        for t in range(ROWS - 1):
            rows.append(swing(rows[t], u[t : t + 1], xi))
        x = np.concatenate(rows) + [1e-3, 1e-2] * rng.normal(size=(ROWS, 2))
        episodes.append(nfpde.Episode(f"{g}", DT * np.arange(ROWS), x[:, :1], x[:, 1:], u))
    simulator = nfpde.CallableSimulator(swing, SPACE, ["q"], ["v"], ["u"])
    return make_problem(simulator, nfpde.Dataset(episodes), horizon)


def test_robots_with_two_modes_go_on_to_the_same_numbers():
    """Saved and restored between the stages: the weights of the modes, and the draws, to the last bit."""
    problem, config = two_modes(6), nfpde.TrajectoryConfig(draws=30, population_rounds=2)
    whole, parts = (TwoStages(problem, config, 0) for _ in range(2))
    while not whole.done:
        whole.step()
    while not parts.alone.done:
        parts.step()
    tensors, info = parts.state()
    parts = TwoStages(problem, config, 0)
    parts.restore(tensors, json.loads(json.dumps(info)))
    while not parts.done:
        parts.step()
    assert whole.together is not None
    assert parts.together is not None
    for a, b in zip(whole.together.posteriors, parts.together.posteriors, strict=True):
        assert len(a.weights) == 2
        for name in ("weights", "means", "covariances"):
            assert getattr(a, name).tolist() == getattr(b, name).tolist()
    assert whole.together.pool is not None
    assert parts.together.pool is not None
    np.testing.assert_array_equal(whole.together.pool.z, parts.together.pool.z)


def test_noises_with_other_tails_are_told_apart_by_their_densities():
    """What two answers are worth differs by twice their log likelihoods, Student's constants among them (SciPy).

    Of windows with four numbers: with two the constant is the same for all tails.
    """
    estimator = TrajectoryEstimator(two_modes(1, 2), nfpde.TrajectoryConfig(horizon=2), 0)
    estimator.step()
    problem, slopes, scatter = estimator.problem, estimator.slopes, estimator.noise.scatter
    assert slopes is not None
    assert estimator.candidates is not None
    worth, density = [], []
    for degrees in (3, 10):
        wider = replace(scatter, degrees=float(degrees))
        noise = Noise.of(wider, slopes, estimator.chains, np.ones(len(slopes)), problem.members)
        estimator.noise = noise
        reweigh(estimator.candidates, noise)
        (best,) = estimator.candidates.best(1)
        white, own = noise.whiten(0, estimator.candidates.residuals[best]), noise.whitening.own
        # an innovation in the units of its residual, with its own scatter
        inverse = np.linalg.inv(own)
        logs = [multivariate_t(shape=w @ w.T, df=degrees).logpdf(w @ e) for w, e in zip(inverse, white, strict=True)]
        worth.append(estimator._worth(0))
        density.append(2 * np.sum(logs))
    # both hold the same prior
    np.testing.assert_allclose(np.diff(worth), np.diff(density), rtol=1e-9)
