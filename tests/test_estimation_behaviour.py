"""A run goes on with the simulator that it began with, by what that does and not by its name alone."""

import functools
import json
from typing import Any

import numpy as np
import pytest
import torch

import nfpde
from nfpde.benchmarks import collect, robot
from nfpde.errors import CheckpointMismatch
from nfpde.estimation.behaviour import difference, observe
from tests.linear_robots import DT, SPACE, linear_simulator

torch.set_num_threads(1)

QUICK = nfpde.NfpdeConfig(iterations=2, samples=20, transitions=8, gradient_steps=2, transforms=2, hidden=8)
FEW = nfpde.TrajectoryConfig(rounds=2, population_rounds=1)


def scaled_step(x, u, xi, gain=1.0):
    return x + DT * (gain * xi[:, :1] * u + xi[:, 1:2])


def scaled(gain):
    return nfpde.CallableSimulator(functools.partial(scaled_step, gain=gain), SPACE, positions=["x"])


class Engine(nfpde.Simulator):
    """A simulator of one's own, which says no more of itself than its class."""

    def __init__(self, gain, number: Any = float):
        self.space, self.gain, self.number = SPACE, gain, number
        self.states = linear_simulator().states
        self.rounding = float(np.finfo(number).eps)

    def rollout(self, xi, windows, vector, window):
        state, ends = windows.state[window, 0], []
        for h in range(windows.horizon):
            state = scaled_step(state, windows.ctrl[window, h], xi[vector], self.gain).astype(self.number)
            ends.append(state.astype(float))
        self.simulated_steps += len(vector) * windows.horizon
        return np.stack(ends, axis=1)


def recordings(rows=40):
    rng = np.random.default_rng(0)
    u = rng.normal(size=(rows, 1))
    x = np.concatenate([[[0.0]], np.cumsum(DT * (2.0 * u[:-1] - 1.0), axis=0)]) + 0.01 * rng.normal(size=(rows, 1))
    return nfpde.Dataset([nfpde.Episode("a", DT * np.arange(rows), x, np.empty((rows, 0)), u)])


@pytest.mark.parametrize("make", [scaled, Engine])
@pytest.mark.parametrize(("method", "config"), [("trajectory", FEW), ("softmax", QUICK)])
def test_another_simulator_of_the_same_name_is_refused(tmp_path, make, method, config):
    """An argument of a partial, or an attribute, that is another one; the message says what comes out otherwise."""
    first = nfpde.fit(make(1.0), recordings(), method=method, config=config, out=tmp_path, quiet=True)
    with pytest.raises(CheckpointMismatch) as caught:
        nfpde.fit(make(1.01), recordings(), method=method, config=config, out=tmp_path, quiet=True)
    for text in ("another simulator of the same name", "qpos x changes by", ": saved ", ", now ", "another folder"):
        assert text in str(caught.value)
    again = nfpde.fit(make(1.0), recordings(), method=method, config=config, out=tmp_path, quiet=True)
    assert again.history == first.history


def test_rounding_is_no_difference(tmp_path):
    """What another machine rounds otherwise, in double or in single precision, goes on as the same simulator."""
    for number, off in ((float, 1e-9), (np.float32, 1e-5)):
        out = tmp_path / f"{off}"
        nfpde.fit(Engine(1.0, number), recordings(), config=FEW, out=out, quiet=True)
        nfpde.fit(Engine(1.0 + off, number), recordings(), config=FEW, out=out, quiet=True)


def test_the_number_of_threads_is_no_difference(tmp_path):
    """Of a robot with contacts; another file of the same model with more friction is one."""
    hopper = robot("hopper")
    dataset, _ = collect(hopper, "mixture", episodes=2, seed=1)
    one, two = (nfpde.MujocoSimulator(hopper.path, hopper.space, nthread=n) for n in (1, 2))
    before = observe(one, dataset)
    assert difference(before, observe(two, dataset), two) is None
    json.dumps(before, allow_nan=False)


def test_what_diverges_is_compared_too():
    """A prediction that was sound and is not any more is the largest difference there is."""

    def broken(x, u, xi):
        return np.where(xi[:, :1] > 3, np.nan, scaled_step(x, u, xi))

    data = recordings()
    fragile = nfpde.CallableSimulator(broken, SPACE, positions=["x"])
    before, now = observe(linear_simulator(), data), observe(fragile, data)
    found = difference(before, now, fragile)
    assert found is not None
    assert found[2] == "diverged"
    assert difference(now, now, fragile) is None
    assert difference(before, before[1:], fragile) is not None


def test_what_tells_the_simulator_is_not_counted(tmp_path):
    """A fit with a folder reports as many simulated steps as one without."""
    alone = nfpde.fit(linear_simulator(), recordings(), config=FEW, quiet=True)
    kept = nfpde.fit(linear_simulator(), recordings(), config=FEW, out=tmp_path, quiet=True)
    assert kept.info["simulated_steps"] == alone.info["simulated_steps"]


def test_a_state_of_another_version_is_refused(tmp_path, monkeypatch):
    """It holds other things; the message says so instead of a key that is missing."""
    monkeypatch.setattr("nfpde.estimation.run.STATE_VERSION", 1)
    nfpde.fit(linear_simulator(), recordings(), config=FEW, out=tmp_path, quiet=True)
    monkeypatch.undo()
    with pytest.raises(CheckpointMismatch, match=r"another version of nfpde \(a state of version 1, .* another folder"):
        nfpde.fit(linear_simulator(), recordings(), config=FEW, out=tmp_path, quiet=True)
