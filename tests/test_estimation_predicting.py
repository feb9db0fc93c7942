"""Whether robots inform each other, and the bounds' share in what they inform each other with."""

import numpy as np
import pytest
from scipy.integrate import trapezoid

import nfpde
from nfpde.dataset import Dataset, Episode
from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.pool import box_log_density
from nfpde.estimation.trajectory.predicting import scores_with_bounds, surely_better, with_bounds

DT = 0.05


@pytest.mark.parametrize("robots", [5, 8, 20])
def test_chance_informs_once_in_twenty(robots):
    """Scores around nothing: Student's t is exact for independent normal ones."""
    rng = np.random.default_rng(0)
    found = np.mean([surely_better(rng.normal(size=robots)) for _ in range(4000)])
    # four standard errors of a share of 4000
    assert found == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 4000))


def test_few_robots_are_never_sure():
    """Four that are all met well might all be met by each other; the fifth makes a scatter of it."""
    assert not surely_better(np.array([5.0, 5.1, 5.2, 4.9]))
    assert surely_better(np.array([5.0, 5.1, 5.2, 4.9, 5.0]))


def test_the_prior_that_informs_is_a_density_with_a_share_of_the_box():
    """Its integral is one, its logs are those of both parts, and its Gaussians are close to it."""
    population = Gaussians(np.array([0.3, 0.7]), np.array([[-1.0], [2.0]]), np.array([[[0.04]], [[0.09]]]))
    prior = with_bounds(population, 4)
    z = np.linspace(-30, 30, 20001)[:, None]
    density = np.exp(prior.log_density(z))
    assert trapezoid(density, z[:, 0]) == pytest.approx(1.0, abs=1e-6)
    parts = 0.8 * np.exp(population.log_density(z)) + 0.2 * np.exp(box_log_density(z))
    np.testing.assert_allclose(density, parts, rtol=1e-12)
    gap = prior.log_density(z) - prior.gaussians.log_density(z)
    # the box's part of 0.014 nats, a fifth of the whole
    assert 0 <= trapezoid(density * np.where(np.abs(z[:, 0]) < 20, gap, 0), z[:, 0]) < 0.2 * 0.015


def test_scores_with_bounds_are_the_evidence_of_that_prior():
    """Log of the mean likelihood under the mixture, above that under the box."""
    scores = np.array([-400.0, -1.0, 0.0, 3.0, 10.0])
    expected = np.log(5 / 6 * np.exp(scores) + 1 / 6)
    np.testing.assert_allclose(scores_with_bounds(scores), expected, rtol=1e-12, atol=1e-15)


def step(state, u, xi):
    """A mass that is pushed and damped."""
    v = state[:, 1:] + DT * (u[:, :1] / xi[:, :1] - xi[:, 1:2] * state[:, 1:])
    return np.hstack([state[:, :1] + DT * v, v])


def fitted(true, rows, seed):
    """Robots (G, 2) of which each pushes itself about for so many rows, exactly simulated, with a little noise."""
    rng = np.random.default_rng(seed)
    space = nfpde.ParameterSpace(
        [nfpde.Parameter("mass", low=0.5, high=5.0), nfpde.Parameter("damping", low=0.0, high=2.0)]
    )
    episodes = []
    for g, (xi, n) in enumerate(zip(true, rows, strict=True)):
        u, states = rng.uniform(-1, 1, (n, 1)), [np.zeros(2)]
        for push in u[:-1]:
            states.append(step(states[-1][None], push[None], xi[None])[0])
        seen = np.array(states) + 1e-3 * rng.normal(size=(n, 2))
        episodes.append(Episode(f"{g}", DT * np.arange(n), seen[:, :1], seen[:, 1:], u, robot=f"{g}"))
    simulator = nfpde.CallableSimulator(step, space, ["x"], ["v"], ["u"])
    config = nfpde.TrajectoryConfig(draws=60, rounds=6, population_rounds=3, starts=2)
    return nfpde.fit(simulator, Dataset(episodes), config=config, seed=seed, quiet=True)


def covered(result, true, robots):
    """Whether the 90 % intervals of those robots hold the truth, one for each parameter."""
    rows = [(result.info["robots"][g]["parameters"], true[g]) for g in robots]
    return [p["5%"] <= v <= p["95%"] for row, xi in rows for p, v in zip(row.values(), xi, strict=True)]


def test_intervals_of_two_different_robots_hold_the_truth():
    """A robot of three rows does not become the well-known one beside it, of which it is no copy."""
    rng = np.random.default_rng(1)
    inside = []
    for seed in range(12):
        true = rng.uniform([1.0, 0.1], [4.5, 1.9], (2, 2))
        result = fitted(true, [40, 3], seed)
        assert not result.info["population"]["informs_robots"]
        inside += covered(result, true, [1])
    # 24 intervals of 90 %: 17 or fewer once in a hundred times
    assert sum(inside) >= 18


def test_robots_of_one_kind_still_inform_each_other():
    """Six alike, of which two hardly moved: these are known far better than by themselves, and rightly."""
    rng = np.random.default_rng(2)
    inside = []
    for seed in range(4):
        true = [2.0, 0.8] + rng.normal(size=(6, 2)) * [0.1, 0.05]
        result = fitted(true, [40, 40, 40, 40, 3, 3], seed)
        assert result.info["population"]["informs_robots"]
        for row in result.info["robots"][4:]:
            assert row["parameters"]["damping"]["known"] < 0.3 < row["parameters"]["damping"]["known_with_others"]
        inside += covered(result, true, [4, 5])
    # 16 intervals of 90 %: 11 or fewer once in sixty times
    assert sum(inside) >= 12
