"""Robots of which only a sum is told: posteriors along the whole ridge, and populations as wide as the bounds."""

import numpy as np
import pytest
import torch

import nfpde
from nfpde import benchmarks
from nfpde.benchmarks.sensing import with_noise
from nfpde.estimation.trajectory.ridges import _Line, along_ridges
from tests.linear_robots import DT, SPACE, both_stages, linear_simulator, moments

torch.set_num_threads(1)

ROWS = 30


def summed(n):
    """A simulator of whose n parameters only the sum acts: x' = x + dt sum(xi)."""
    space = nfpde.ParameterSpace([nfpde.Parameter(f"part_{i}", low=-10.0, high=10.0) for i in range(n)])
    return nfpde.CallableSimulator(lambda x, u, xi: x + DT * xi.sum(1, keepdims=True), space, positions=["x"])


def recorded(name, total, noise, rng):
    """A recording of a robot whose parameters sum up to `total`."""
    x = DT * total * np.arange(ROWS)[:, None] + rng.normal()
    x = x + noise * rng.normal(size=x.shape)
    return nfpde.Episode(name, DT * np.arange(ROWS), x, np.empty((ROWS, 0)), np.ones((ROWS, 1)))


def spread_of_parts(n, total, rng):
    """Standard deviation of a part, uniform in the bounds, of a known sum: the last is what the others leave."""
    parts = rng.uniform(-10, 10, (400_000, n - 1))
    last = total - parts.sum(1)
    return float(parts[np.abs(last) <= 10, 0].std())


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.1])
@pytest.mark.parametrize("n", [2, 3, 5])
def test_one_robot_is_as_wide_as_its_ridge(n, noise):
    """The posterior of the parts, whatever the noise of the sum; Gaussians in z have less than all of the ends."""
    rng = np.random.default_rng(n)
    result = nfpde.fit(summed(n), nfpde.Dataset([recorded("a", 2.0, noise, rng)]), quiet=True)
    xi = result.distribution.sample(4000)
    exact = spread_of_parts(n, 2.0, rng)
    assert (0.65 * exact < xi.std(0)).all()
    assert (xi.std(0) < 1.2 * exact).all()
    if n == 2:
        # links are short enough to leave little more than the recording does: the error of a straight line's slope
        # through ROWS points, and a thousandth of the bounds where that is less
        told = noise * np.sqrt(12 / ROWS**3) / DT
        assert xi.sum(1).std() < 1.5 * told + 0.02
        np.testing.assert_allclose(xi.sum(1).mean(), 2.0, atol=3 * told + 0.01)
    else:
        # straight links leave what bends in two directions and more, by far less than the bounds leave the sum
        assert xi.sum(1).std() < 0.2 * np.sqrt(n) * 20 / np.sqrt(12)
        np.testing.assert_allclose(xi.sum(1).mean(), 2.0, atol=0.5)


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_a_hand_and_its_payload(share):
    """Welded masses of MuJoCo: their sum is told, the split is uniform as far as the bounds of both allow."""
    robot = benchmarks.robot("payload")
    xi = robot.space.uniform(1, np.random.default_rng(5))
    clean = benchmarks.record(robot, xi, steps=60, rng=np.random.default_rng(6))
    dataset, _ = with_noise(robot.model, clean, share, seed=7)
    found = nfpde.fit(nfpde.MujocoSimulator(robot.path, robot.space), dataset, quiet=True).distribution.sample(4000)
    # the sum as well as by a fit that holds one of them
    one = nfpde.ParameterSpace([nfpde.Parameter("body_mass", "payload", low=0.05, high=1.0), robot.space[2]])
    alone = nfpde.fit(nfpde.MujocoSimulator(robot.path, one), dataset, quiet=True).distribution.sample(4000)[:, 0] + 0.3
    both = found[:, :2].sum(1)
    assert both.std() < 1.5 * alone.std() + 1e-3
    np.testing.assert_allclose(both.mean(), alone.mean(), atol=0.5 * alone.std() + 1e-3)
    total, (low, high) = both.mean(), np.transpose([robot.space.low[:2], robot.space.high[:2]])[0]
    ends = max(low, total - high), min(high, total - low)
    # of all that is left of the split the middle half is as likely as it is wide: a binomial of as many effective
    # draws, one in a hundred of them at least, and Gaussians in z that end before the bounds
    middle = np.abs(found[:, 0] - np.mean(ends)) < 0.25 * (ends[1] - ends[0])
    assert 0.35 < middle.mean() < 0.65
    np.testing.assert_allclose(found[:, 0].std(), (ends[1] - ends[0]) / np.sqrt(12), rtol=0.2)


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.1])
@pytest.mark.parametrize("robots", [4, 12])
def test_a_population_is_as_wide_as_the_bounds_where_no_robot_tells(robots, noise):
    rng = np.random.default_rng(robots)
    totals = 1.0 + rng.normal(size=robots)
    dataset = nfpde.Dataset([recorded(f"{i}", s, noise, rng) for i, s in enumerate(totals)])
    result = nfpde.fit(summed(2), dataset, quiet=True)
    xi = result.distribution.sample(4000)
    exact = spread_of_parts(2, 1.0, rng)
    # where few Gaussians predict the sum better, they are not as long
    assert (0.3 * exact < xi.std(0)).all()
    assert (xi.std(0) < 1.2 * exact).all()
    # smoothing may widen, and so may the bend
    assert 0.5 * totals.std() < xi.sum(1).std() < 2 * totals.std()
    for robot, total in zip(result.info["robots"], totals, strict=True):
        # best values on the ridge, to four of a slope's standard errors through ROWS points
        best = sum(p["value"] for p in robot["parameters"].values())
        assert abs(best - total) < 4 * noise * np.sqrt(12 / ROWS**3) / DT + 1e-6
        assert len(robot["combinations"]) == 1
        assert all(p["known"] < 0.3 for p in robot["parameters"].values())


def test_whoever_is_told_stays_as_it_was():
    """Robots that tell both parameters, and one that tells the first only, for which there is nothing to bend."""
    rng = np.random.default_rng(3)
    _, together = both_stages(linear_simulator(), nfpde.Dataset(moments("a", (2.0, -1.0), rng, 20, 0.02)))
    assert along_ridges(together.problem, together.noise, together.posteriors)[0] is together.posteriors[0]


def test_links_are_on_the_ridge():
    """They lie where the sum is right, from bound to bound, and have together the weight of the posterior."""
    rng = np.random.default_rng(4)
    episode = recorded("a", 2.0, 1e-3, rng)
    _, together = both_stages(summed(2), nfpde.Dataset([episode]))
    (chain,) = together.chains
    assert len(chain.weights) > 3
    xi = SPACE.to_physical(chain.means)
    np.testing.assert_allclose(xi.sum(1), 2.0, atol=0.01)
    assert np.ptp(xi[:, 0]) > 10
    np.testing.assert_allclose(chain.weights.sum(), 1.0)


@pytest.mark.parametrize(("links", "d", "tolerance"), [(3, 2, 0.3), (8, 2, 0.015), (40, 2, 0.015), (64, 3, 0.15)])
def test_links_of_a_straight_line_are_the_gaussian_in_their_place(links, d, tolerance):
    """A likelihood that is quadratic in z, a prior that is Gaussian: weight and covariance of all links together.

    Beyond three standard deviations, where chains end, lie 3 % of a Gaussian's variance; three links have no ends.
    """
    rng = np.random.default_rng(d)
    sharp = np.linalg.qr(rng.normal(size=(d, d)))[0][:, :1]
    fisher, prior = 1e6 * sharp @ sharp.T, 0.5 * np.eye(d)
    line = _Line.through(np.zeros(d), fisher, links)
    assert len(line.places) == links
    whole, own = (np.linalg.inv(fisher + prior + extra) for extra in (0, line.window))
    height = -0.5 * np.einsum("nd,de,ne->n", line.places, fisher + prior, line.places)
    weights = np.exp(height + line.log_share) * np.sqrt(np.linalg.det(own) / np.linalg.det(whole))
    np.testing.assert_allclose(weights.sum(), 1.0, rtol=tolerance)
    weights /= weights.sum()
    together = own + (line.places.T * weights) @ line.places
    np.testing.assert_allclose(together, whole, atol=2 * tolerance * whole.max())
