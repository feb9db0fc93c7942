"""Simulators that are not MuJoCo: a function, and a user's own class."""

import functools
import json

import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode, Windows
from nfpde.errors import BadDataset, BadInput, BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import LOSS_LIMIT, CallableSimulator, Simulator, StateSpace

DT = 0.05
SPACE = ParameterSpace([Parameter("stiffness", low=1.0, high=9.0), Parameter("offset", low=-1.0, high=1.0)])


def oscillator(state, ctrl, xi):
    """The exact solution of x'' = -k (x - c - u) over one step."""
    w, rest = np.sqrt(xi[:, 0]), xi[:, 1] + ctrl[:, 0]
    x, v = state[:, 0] - rest, state[:, 1]
    c, s = np.cos(w * DT), np.sin(w * DT)
    return np.stack([rest + x * c + v * s / w, -x * w * s + v * c], axis=1)


def make(n, horizon, nq=1, nv=1, nu=1, seed=0):
    rng = np.random.default_rng(seed)
    return Windows(
        state=rng.normal(size=(n, horizon + 1, nq + nv)),
        ctrl=np.zeros((n, horizon, nu)),
        history=np.zeros((n, 0, nu)),
        control_dt=DT,
        nq=nq,
        nv=nv,
        episode=np.zeros(n, int),
        row=np.arange(n),
    )


def test_closed_form():
    """H steps of the exact map are the solution at time H dt, for every pair."""
    sim = CallableSimulator(oscillator, SPACE, ["x"], ["v"])
    windows = make(5, 40)
    xi = SPACE.uniform(4, np.random.default_rng(1))
    predicted = sim.predict(xi, windows)
    t = DT * np.arange(1, 41)
    for i, (k, c) in enumerate(xi):
        for n, (x, v) in enumerate(windows.start):
            w = np.sqrt(k)
            exact = np.stack(
                [c + (x - c) * np.cos(w * t) + v / w * np.sin(w * t), (c - x) * w * np.sin(w * t) + v * np.cos(w * t)],
                1,
            )
            np.testing.assert_allclose(predicted[i, n], exact, rtol=1e-12, atol=1e-12)
    by_hand = ((predicted - windows.target) ** 2).sum((2, 3))
    np.testing.assert_allclose(sim.losses(xi, windows, np.ones(2)), by_hand, rtol=1e-13)
    assert sim.simulated_steps == 2 * 4 * 5 * 40
    assert sim.memory_time == 0


def test_nan_and_infinity_are_divergences():
    """From the row's first number that is not finite on; other rows are unaffected."""

    def grow(state, ctrl, xi):
        with np.errstate(over="ignore"):
            return np.where(state < 1e3, state * 10, np.inf)

    sim = CallableSimulator(grow, ParameterSpace([Parameter("x", low=0, high=1)]), ["a", "b"])
    windows = make(2, 6, nq=2, nv=0)
    state = np.ones_like(windows.state)
    state[0, 0] = [1.0, 200.0]
    state[1, 0] = [0.001, 0.0001]
    windows = Windows(state, windows.ctrl, windows.history, DT, 2, 0, windows.episode, windows.row)
    predicted = sim.predict([[0.5]], windows)[0]
    np.testing.assert_allclose(predicted[0, 0], [10, 2000])
    assert np.isnan(predicted[0, 1:]).all()
    np.testing.assert_allclose(predicted[1, -1], [1e3, 1e2])
    losses = sim.losses([[0.5]], windows, np.ones(2))
    assert losses[0, 0] == LOSS_LIMIT
    assert losses[0, 1] < 1e9


def test_wrong_shapes_are_refused():
    """A function that drops the row axis, and windows of another robot."""
    bad = CallableSimulator(lambda x, u, xi: x[0], SPACE, ["x"], ["v"])
    with pytest.raises(BadInput, match=r"step must return next states of shape \(3, 2\), it returned \(2,\)"):
        bad.predict([[2.0, 0.0]], make(3, 2))
    with pytest.raises(BadInput, match="the windows have nq=2, nv=1, the simulator nq=1, nv=1"):
        bad.predict([[2.0, 0.0]], make(3, 2, nq=2))
    with pytest.raises(BadParameter, match="outside"):
        bad.predict([[2.0, 3.0]], make(3, 2))


def test_the_number_of_commands_is_checked_where_they_have_names():
    """Without names the function gets what there is; its own errors are passed on."""
    two = Dataset([Episode("a", [0, DT], np.zeros((2, 1)), np.zeros((2, 1)), np.zeros((2, 2)))])
    with pytest.raises(BadDataset, match=r"the data has nu=2, the simulator 1 command\(s\): force"):
        CallableSimulator(oscillator, SPACE, ["x"], ["v"], ["force"]).prepare(two)
    with pytest.raises(BadDataset, match=r"the data has nu=2, the simulator 0 command\(s\): \(none\)"):
        CallableSimulator(oscillator, SPACE, ["x"], ["v"], []).prepare(two)
    with pytest.raises(BadDataset, match="the data has nq=1, nv=1, the simulator nq=2"):
        CallableSimulator(oscillator, SPACE, ["x", "y"], ["v"], ["force", "brake"]).prepare(two)
    for commands in (None, ["force", "brake"]):
        assert CallableSimulator(oscillator, SPACE, ["x"], ["v"], commands).prepare(two) is two
    with pytest.raises(IndexError, match="out of bounds"):
        CallableSimulator(oscillator, SPACE, ["x"], ["v"]).predict([[2.0, 0.0]], make(3, 2, nu=0))


def test_identities_differ_where_simulators_do():
    """Other names of channels or commands, another function; a partial and an object go by what they call."""

    def other(state, ctrl, xi):
        return state

    class Learned:
        def __call__(self, state, ctrl, xi):
            return state

    base = (oscillator, SPACE, ["x"], ["v"], None)
    changed = [
        base,
        (other, *base[1:]),
        (Learned(), *base[1:]),
        (Learned().__call__, *base[1:]),
        (*base[:2], ["y"], *base[3:]),
        (*base[:2], ["x", "v"], [], None),
        (*base[:4], ["force"]),
    ]
    texts = [json.dumps(CallableSimulator(*arguments).identity()) for arguments in changed]
    assert len(set(texts)) == len(texts)
    again = CallableSimulator(functools.partial(oscillator), *base[1:]).identity()
    assert again == CallableSimulator(*base).identity()
    assert again["step"] == f"{__name__}.oscillator"
    assert CallableSimulator(Learned(), *base[1:]).identity()["step"].endswith(".Learned")


class Coin(Simulator):
    """A user's simulator of ten lines: the state moves by xi, whatever the command."""

    def __init__(self):
        self.space = ParameterSpace([Parameter("drift", low=-1.0, high=1.0)])
        self.states = StateSpace.euclidean(["x"], [])

    def rollout(self, xi, windows, vector, window):
        steps = np.arange(1, windows.horizon + 1)
        self.simulated_steps += len(vector) * windows.horizon
        return (windows.start[window] + xi[vector] * steps)[:, :, None]


def test_a_users_own_simulator_needs_rollout_only():
    """Predictions, losses, checks and chunks come with the base class."""
    sim = Coin()
    windows = make(700, 3, nv=0)
    xi = sim.space.uniform(9, np.random.default_rng(0))
    expected = windows.start[None, :, None, :] + xi[:, None, None, :] * np.array([1, 2, 3])[:, None]
    np.testing.assert_allclose(sim.predict(xi, windows), expected, rtol=1e-15)
    losses = sim.losses(xi, windows, np.array([2.0]))
    np.testing.assert_allclose(losses, (((expected - windows.target) / 2) ** 2).sum((2, 3)), rtol=1e-12)
    assert sim.simulated_steps == 2 * 9 * 700 * 3
    assert Coin().simulated_steps == 0
    with pytest.raises(TypeError, match="abstract"):
        Simulator()  # type: ignore[abstract]
