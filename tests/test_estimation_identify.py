"""What recordings determine, in words, and what to record next: on systems where the answer is known."""

import numpy as np
import pytest
import torch

import nfpde
from nfpde import benchmarks
from nfpde.benchmarks.sensing import with_noise
from nfpde.estimation import tell
from nfpde.estimation.trajectory.advice import _Worth
from nfpde.estimation.trajectory.identify import UNIFORM_STD, Knowledge, describe_knowledge
from nfpde.estimation.trajectory.information import inverse
from nfpde.estimation.trajectory.modes import LocalPosterior

torch.set_num_threads(1)
DT = 0.1


def space_of(*names, low=1.0, high=9.0, unit="kg"):
    return nfpde.ParameterSpace([nfpde.Parameter(n, low=low, high=high, unit=unit) for n in names])


def episodes_of(step, xi, rng, noise, rows=30, states=1, push=1.0, count=3):
    """Recordings of robots that are all the same, with noise on what is measured."""
    found = []
    for i in range(count):
        u = push * rng.normal(size=(rows, 1))
        x = [push * rng.normal(size=states)]
        for row in u[:-1]:
            x.append(step(x[-1][None], row[None], np.asarray(xi)[None])[0])
        x = np.array(x) + noise * rng.normal(size=(rows, states))
        split = 1 if states > 1 else states
        found.append(nfpde.Episode(f"{i}", DT * np.arange(rows), x[:, :split], x[:, split:], u))
    return nfpde.Dataset(found)


def posterior(weights, means, fisher):
    """A robot's modes; the covariances in z are not looked at."""
    means, fisher = np.asarray(means, float), np.asarray(fisher, float)
    return LocalPosterior(np.asarray(weights), means, np.full(fisher.shape, np.nan), fisher)


def test_two_modes_are_two_values():
    """Values and weights of both; the error is that of the mixture, and each value's own is in the words.

    Modes at xi = -2 and 2, each known to 0.01, by hand: the mixture's variance is 0.25 x 4 x 4 + 0.01^2.
    """
    space = nfpde.ParameterSpace([nfpde.Parameter("speed", low=-4.0, high=4.0, unit="m")])
    z = space.to_unconstrained([[-2.0], [2.0]])
    slope = 8.0 * np.exp(-z) / (1 + np.exp(-z)) ** 2
    both = Knowledge.of(space, posterior([0.5, 0.5], z, (slope**2 / 0.01**2)[:, :, None]))
    np.testing.assert_allclose(both.std, np.sqrt(4.0 + 0.01**2), rtol=1e-6)
    np.testing.assert_allclose(both.value, [-2.0])
    assert both.words(0) == "-2 or 2, each known to 0.01 m"
    rare = Knowledge.of(space, posterior([0.99, 0.01], z, (slope**2 / 0.01**2)[:, :, None]))
    np.testing.assert_allclose(rare.std, 0.01, rtol=1e-4)
    assert rare.words(0) == "known to 0.01 m"
    # in the middle d xi / d z is 2; with the bounds' own 2.3 the error is 1 / root(1 / 0.5^2 + 1 / 2.3^2)
    close = Knowledge.of(space, posterior([0.6, 0.4], z / 100, np.full((2, 1, 1), 2.0**2 / 0.5**2)))
    assert close.words(0) == "known to 0.49 m"


def test_knowledge_is_information_and_bounds_together():
    """Covariance in physical units: the inverse of Fisher information plus that of a uniform prior."""
    space = nfpde.ParameterSpace([nfpde.Parameter("a", low=0.0, high=2.0), nfpde.Parameter("b", low=-1.0, high=4.0)])
    z = np.array([0.3, -0.8])
    slope = space.width * (np.exp(-z) / (1 + np.exp(-z)) ** 2)
    physical = np.array([[40.0, 5.0], [5.0, 3.0]])
    found = Knowledge.of(space, posterior([1.0], [z], [physical * np.outer(slope, slope)]))
    expected = np.linalg.inv(physical + np.diag(1 / (UNIFORM_STD * space.width) ** 2))
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-9)
    np.testing.assert_allclose(found.value, space.to_physical(z))


def test_without_information_only_the_bounds_are_left():
    """Standard errors are those of a uniform distribution, and nothing counts as told."""
    space = space_of("a", "b")
    found = Knowledge.of(space, posterior([1.0], np.zeros((1, 2)), np.zeros((1, 2, 2))))
    np.testing.assert_allclose(found.std, 8 / np.sqrt(12))
    assert not found.told.any()
    assert found.words(0) == "not told by these recordings"
    assert found.pairs() == []


def test_two_masses_that_act_as_one():
    """With x' = x + dt u / (a + b) the sum is known, the split is not, and one sentence says both."""
    space = space_of("upper", "lower")

    def step(x, u, xi):
        return x + DT * u / (xi[:, :1] + xi[:, 1:])

    rng = np.random.default_rng(0)
    simulator = nfpde.CallableSimulator(step, space, positions=["x"])
    result = nfpde.fit(simulator, episodes_of(step, (3.0, 4.0), rng, 1e-4), quiet=True)
    (row,) = result.info["tells"]["combinations"]
    assert row["robots"] == 3
    assert row["words"].startswith("upper + lower is known to ")
    known, split = (float(part.split(" %")[0].split()[-1]) for part in row["words"].split(", their split only to"))
    assert known < 2
    assert split > 10
    assert any("upper + lower" in line for line in tell(result))


def test_a_ratio_is_named_as_one():
    """Where only a / b acts, with values far from equal, the words say the ratio."""
    space = space_of("gain", "inertia", unit="")

    def step(x, u, xi):
        return x + DT * u * xi[:, :1] / xi[:, 1:]

    rng = np.random.default_rng(1)
    simulator = nfpde.CallableSimulator(step, space, positions=["x"])
    result = nfpde.fit(simulator, episodes_of(step, (2.0, 6.0), rng, 1e-4), quiet=True)
    (row,) = result.info["tells"]["combinations"]
    assert row["words"].startswith("gain / inertia is known to ")


def test_three_that_only_act_together():
    """Of x' = x + dt u / (a + b + c) no pair is tied, but the sum of all three is known."""
    space = space_of("a", "b", "c")

    def step(x, u, xi):
        return x + DT * u / xi.sum(1, keepdims=True)

    rng = np.random.default_rng(5)
    simulator = nfpde.CallableSimulator(step, space, positions=["x"])
    result = nfpde.fit(simulator, episodes_of(step, (4.0, 5.0, 6.0), rng, 1e-4), quiet=True)
    (row,) = result.info["tells"]["combinations"]
    assert row["words"].startswith("a + b + c is known to ")


def test_robots_that_tell_and_robots_that_do_not_are_counted():
    """The words say how many robots tell a parameter."""
    space = space_of("a", "b")
    value = np.array([4.0, 5.0])
    knows, blind = (
        Knowledge(space, value, np.diag(v), value[None], np.sqrt([v])) for v in ([0.04, 0.0025], [5.3, 0.0025])
    )
    found = describe_knowledge([knows, knows, blind])["parameters"]
    assert found["a"]["words"] == "known to 5 % in 2 of 3 robots, not told by the recordings of the others"
    assert found["b"]["words"] == "known to 1 %"
    assert (found["a"]["told"], found["a"]["robots"]) == (2, 3)


def test_damping_of_a_joint_at_rest_asks_for_motion():
    """A joint that hardly moves cannot tell its damping; the advice is to move it, and not to push elsewhere."""
    space = nfpde.ParameterSpace([nfpde.Parameter("damping", low=0.1, high=4.0)])

    def step(state, u, xi):
        """Two carts: the first feels the command, the damping acts on the second alone."""
        x, v, w = state[:, :2], state[:, 2:3], state[:, 3:4]
        return np.concatenate([x + DT * state[:, 2:], v + DT * u, w * (1 - DT * xi)], axis=1)

    rng = np.random.default_rng(2)
    episodes = []
    for i in range(3):
        u = rng.normal(size=(30, 1))
        x = [np.array([0.0, 0.0, 1.0, 0.02])]
        for row in u[:-1]:
            x.append(step(x[-1][None], row[None], np.array([[1.0]]))[0])
        x = np.array(x) + 0.01 * rng.normal(size=(30, 4))
        episodes.append(nfpde.Episode(f"{i}", DT * np.arange(30), x[:, :2], x[:, 2:], u))
    simulator = nfpde.CallableSimulator(step, space, ["cart", "wheel"], ["cart", "wheel"])
    result = nfpde.fit(simulator, nfpde.Dataset(episodes), quiet=True)
    (advice,) = result.info["record_next"]
    assert advice["parameter"] == "damping"
    assert advice["gains"]
    assert all("wheel" in row["change"] for row in advice["gains"])
    assert all(row["gain"] is None or row["gain"] > 1.5 for row in advice["gains"])
    assert any("faster motion of wheel" in line for line in tell(result))


def test_more_of_what_tells_a_sum_is_worth_nothing_to_its_parts():
    """Two parameters, told the sum: as sharp again or a thousand times as long, each stays what the bounds leave it."""
    bounds, both = np.eye(2) * 12.0, np.ones((2, 2))
    worth = _Worth.of(inverse(bounds + 1e6 * both), 0, moments=100)
    assert worth.added(1e4 * both) < 1e-3 * 12
    assert not worth.tells(1e4 * both)
    assert worth.tells(np.diag([0.0, 1.0]))
    assert worth.times_longer() is None
    # the first alone: 1e4 a moment, a hundred of them, and the sum passes on nothing that is not known of the other
    np.testing.assert_allclose(worth.added(np.diag([1e4, 0.0])), 1e6, rtol=1e-6)


def test_how_much_longer():
    """Information grows with the length of what is recorded: 1 / 0.05^2 is wanted, of which the bounds are 12."""
    worth = _Worth.of(np.diag([1 / (12 + 50.0), 1 / 12]), 0, moments=10)
    assert worth.times_longer() == pytest.approx((400 - 12) / 50, rel=1e-6)
    assert _Worth.of(np.diag([1 / (12 + 1e-3), 1 / 12]), 0, moments=10).times_longer() is None


@pytest.mark.parametrize("share", [0.0, 0.01, 0.1])
def test_no_motion_is_asked_for_that_cannot_tell(share):
    """A hand and what it holds: commands tell more of both together and nothing of either."""
    body = benchmarks.robot("payload")
    clean = benchmarks.collect(body, "gaussian", episodes=2, steps=60)[0]
    dataset, _ = with_noise(body.model, clean, share, seed=0)
    info = nfpde.fit(nfpde.MujocoSimulator(body.path, body.space), dataset, quiet=True).info
    rows = {row["parameter"]: row for row in info["record_next"]}
    for name, other in (("hand", "payload"), ("payload", "hand")):
        row = rows[f"body_mass:{name}"]
        assert row["gains"] == []
        assert row["times_longer"] is None
        if share < 0.1:  # above, their sum is not known so much better that they are named together
            assert f"would tell it from body_mass:{other}; weigh or measure one of them" in row["words"]


def test_nothing_is_asked_for_where_everything_is_known():
    """Clean recordings of a moving system leave nothing to record."""
    space = nfpde.ParameterSpace([nfpde.Parameter("rate", low=0.1, high=4.0)])

    def step(x, u, xi):
        return x * (1 - DT * xi) + DT * u

    simulator = nfpde.CallableSimulator(step, space, positions=["x"])
    result = nfpde.fit(simulator, episodes_of(step, (1.0,), np.random.default_rng(3), 0.0), quiet=True)
    assert result.info["record_next"] == []
    assert result.info["tells"]["parameters"]["rate"]["words"] == "known to better than 0.001 %"


def test_errors_before_and_after():
    """Before: the middle of the bounds; after: what noise leaves. Both in the recorded units."""
    space = nfpde.ParameterSpace([nfpde.Parameter("gain", low=0.0, high=4.0)])

    def step(x, u, xi):
        return x + DT * xi * u

    rng = np.random.default_rng(4)
    dataset = episodes_of(step, (3.0,), rng, 0.0)
    simulator = nfpde.CallableSimulator(step, space, positions=["x"])
    (row,) = nfpde.fit(simulator, dataset, quiet=True).info["residuals"].values()
    pushes = np.concatenate([e.ctrl[:-1, 0] for e in dataset])
    assert row["before"] == pytest.approx(DT * np.sqrt((pushes**2).mean()))
    assert row["after"] < 1e-8
