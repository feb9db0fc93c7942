"""Robots whose motion is linear in their parameters, both stages of the fit by trajectories on them, sharp robots."""

import numpy as np
import torch

import nfpde
from nfpde.estimation.trajectory import make_problem
from nfpde.estimation.trajectory.pool import Ratios, box_log_density
from nfpde.estimation.trajectory.stages import TwoStages

torch.set_num_threads(1)


DT = 0.1
SPACE = nfpde.ParameterSpace(
    [nfpde.Parameter("gain", low=-10.0, high=10.0), nfpde.Parameter("drift", low=-10, high=10)]
)


def linear_step(x, u, xi):
    """A first-order system that is linear in its parameters: x' = x + dt (gain u + drift)."""
    return x + DT * (xi[:, :1] * u + xi[:, 1:2])


def linear_simulator():
    return nfpde.CallableSimulator(linear_step, SPACE, positions=["x"])


def moments(name, xi, rng, count=12, noise=0.1, push=1.0):
    """Recordings of two rows each of one robot: windows with independent noise on their ends."""
    episodes = []
    for k in range(count):
        u, start = push * rng.normal(size=1), rng.normal(size=1)
        end = start + DT * (xi[0] * u + xi[1]) + noise * rng.normal(size=1)
        episodes.append(nfpde.Episode(f"{name}/{k}", [0, DT], [start, end], np.empty((2, 0)), [u, u], robot=name))
    return episodes


def sharp(points):
    """Ratios of robots that are known to be at `points` (G, D), above the uniform box as every robot's are."""
    return Ratios(points[:, None], -box_log_density(points)[:, None], np.ones(len(points)), np.ones(len(points), bool))


def both_stages(simulator, dataset, seed=0, resolution=None, horizon=1, **settings):
    config = nfpde.TrajectoryConfig(horizon=horizon, **settings)
    estimator = TwoStages(make_problem(simulator, dataset, horizon, resolution), config, seed)
    while not estimator.done:
        estimator.step()
    assert estimator.together is not None
    return estimator, estimator.together
