"""The run around the estimator: recovery of a truth, interruption, checkpoints, results, refusals."""

import functools
import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import nfpde
from nfpde.dataset import Dataset, Episode
from nfpde.errors import BadDataset, BadInput, CheckpointMismatch, SimulationDiverged
from nfpde.estimation import FitResult, NfpdeConfig
from nfpde.losses import increment_scale
from nfpde.ot import emd
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import CallableSimulator
from nfpde.storage import alone_in

fit = functools.partial(nfpde.fit, method="softmax")

DT = 0.1
SPACE = ParameterSpace([Parameter("stiffness", low=1.0, high=9.0), Parameter("offset", low=-1.0, high=1.0)])
TRUE = np.array([3.0, 0.4])
LEARNING = NfpdeConfig(
    iterations=30,
    samples=300,
    transitions=32,
    gradient_steps=8,
    learning_rate=5e-3,
    transforms=3,
    hidden=16,
    least_effective=5.0,
)
TINY = NfpdeConfig(iterations=5, samples=20, transitions=8, gradient_steps=2, transforms=2, hidden=8)


def oscillator(state, ctrl, xi):
    """The exact solution of x'' = -k (x - c - u) over one step."""
    w, rest = np.sqrt(xi[:, 0]), xi[:, 1] + ctrl[:, 0]
    x, v = state[:, 0] - rest, state[:, 1]
    c, s = np.cos(w * DT), np.sin(w * DT)
    return np.stack([rest + x * c + v * s / w, -x * w * s + v * c], axis=1)


def simulator(step=oscillator, space=SPACE):
    return CallableSimulator(step, space, ["x"], ["v"])


def record(episodes=4, steps=15, seed=0):
    rng = np.random.default_rng(seed)
    found = []
    for e in range(episodes):
        ctrl = rng.uniform(-1, 1, (steps + 1, 1))
        states = [rng.normal(size=2)]
        for u in ctrl[:-1]:
            states.append(oscillator(states[-1][None], u[None], TRUE[None])[0])
        both = np.array(states)
        found.append(Episode(f"{e}", DT * np.arange(steps + 1), both[:, :1], both[:, 1:], ctrl))
    return Dataset(found)


DATA = record()


class Counted:
    """The oscillator, which does something else at one of its calls.

    With these settings there is one call for every iteration, and one before them: where there is a folder the
    simulator's behaviour is compared with that of the run that it belongs to.
    """

    def __init__(self, at=None, then=None):
        self.calls, self.at, self.then = 0, at, then
        functools.update_wrapper(self, oscillator)  # a run goes on with the function it began with

    def __call__(self, state, ctrl, xi):
        self.calls += 1
        if self.calls == self.at:
            assert self.then is not None
            self.then()
        return oscillator(state, ctrl, xi)


def interrupt():
    raise KeyboardInterrupt


def numbers(result):
    """Everything a fit found and counted, bit for bit, seconds left out."""
    info = {k: v for k, v in result.info.items() if k != "seconds"}
    rows = [{k: v for k, v in row.items() if k != "seconds"} for row in result.history]
    draws = [d.sample(50, seed=1).tobytes() for d in (result.distribution, result.initial)]
    return draws, json.dumps([info, rows])


@pytest.fixture(scope="module")
def uninterrupted():
    return fit(simulator(), DATA, config=TINY, seed=2, quiet=True)


@pytest.mark.parametrize("horizon", [1, 3])
def test_the_truth_is_recovered(horizon):
    """Exact data of one robot: the distribution closes in on its parameters."""
    result = fit(simulator(), DATA, config=replace(LEARNING, horizon=horizon), seed=1, quiet=True)
    before, after = (d.sample(500) for d in (result.initial, result.distribution))
    # the temperature keeps 5 of 300 samples: the distribution ends a few of the last samples' spacings wide
    assert (
        emd(after / SPACE.width, TRUE[None] / SPACE.width).cost
        < 0.2 * emd(before / SPACE.width, TRUE[None] / SPACE.width).cost
    )
    np.testing.assert_allclose(after.mean(0) / SPACE.width, TRUE / SPACE.width, atol=0.05)
    assert result.info["transitions"] == 4 * (15 - horizon + 1)
    assert result.info["episodes"] == 4
    # M x B simulations of H steps an iteration
    assert result.info["simulated_steps"] == 30 * 300 * 32 * horizon


def test_half_of_the_box_diverges():
    """Simulations that blow up for stiffness above 5 do not keep the fit from the truth below it."""

    def fragile(state, ctrl, xi):
        out = oscillator(state, ctrl, xi)
        out[xi[:, 0] > 5.0] = np.nan
        return out

    result = fit(simulator(fragile), DATA, config=LEARNING, quiet=True)
    assert result.history[0]["diverged"] > 0.3
    assert result.history[-1]["diverged"] < 0.1
    assert np.isfinite([row["loss"] for row in result.history]).all()
    assert (result.initial.sample(500)[:, 0] > 5.0).mean() > 0.3
    # a sample there has no weight at all: what is left is the flow's tail
    assert (result.distribution.sample(500)[:, 0] > 5.0).mean() < 0.02
    np.testing.assert_allclose(result.distribution.mean() / SPACE.width, TRUE / SPACE.width, atol=0.05)


@pytest.mark.parametrize("method", ["softmax", "cai"])
def test_everything_diverges(method):
    """With all losses at their limit nothing is learned, and the distribution at the start is no answer."""
    with pytest.raises(SimulationDiverged, match=r"every simulation of the 60 transitions diverged.*control step"):
        fit(simulator(lambda x, u, xi: np.full_like(x, np.nan)), DATA, method=method, config=TINY, quiet=True)


@pytest.mark.parametrize("method", ["softmax", "cai"])
def test_some_transitions_diverge(method):
    """Where an iteration meets only transitions of which no simulation is sound the fit goes on, and says so."""

    def fragile(state, ctrl, xi):
        out = oscillator(state, ctrl, xi)
        out[state[:, 0] > 0] = np.nan
        return out

    config = replace(TINY, transitions=1, iterations=12)
    result = fit(simulator(fragile), DATA, method=method, config=config, quiet=True)
    # one transition each, of which all simulations diverge or none
    assert {row["diverged"] for row in result.history} == {0.0, 1.0}
    assert np.isfinite(result.distribution.sample(100)).all()
    # with more of them in an iteration the others tell as much as ever
    found = fit(simulator(fragile), DATA, method=method, config=LEARNING, seed=1, quiet=True)
    assert all(0 < row["diverged"] < 1 for row in found.history)
    xi = found.distribution.sample(500) / SPACE.width
    np.testing.assert_allclose(xi.mean(0), TRUE / SPACE.width, atol=0.05)
    assert (xi.std(0) < 0.1).all()
    if method == "softmax":
        assert found.history[-1]["beta"] < 0.1


@pytest.mark.parametrize("call", [1, 2, 5])
@pytest.mark.parametrize("often", [False, True])
def test_an_interrupted_fit_goes_on(tmp_path, monkeypatch, uninterrupted, call, often):
    """Ctrl-C inside the simulator: a checkpoint is left, and the same call ends in the same numbers bit for bit."""
    if often:  # a checkpoint after every iteration, instead of one in five seconds
        monkeypatch.setattr(sys.modules["nfpde.estimation.run"], "CHECKPOINT_SECONDS", 0.0)
    stopped = Counted(call + 1, interrupt)
    with pytest.raises(KeyboardInterrupt) as caught:
        fit(simulator(stopped), DATA, config=TINY, seed=2, out=tmp_path, quiet=True)
    assert f"state after {call - 1} of 5 iterations, from which the same call goes on" in str(caught.value)
    assert str(tmp_path) in str(caught.value)
    assert (tmp_path / "checkpoint" / "state.safetensors").is_file()
    assert not (tmp_path / "fit.json").exists()
    rest = Counted()
    result = fit(simulator(rest), DATA, config=TINY, seed=2, out=tmp_path, quiet=True)
    assert rest.calls == 1 + 5 - (call - 1)
    assert numbers(result) == numbers(uninterrupted)


def test_an_interrupt_without_a_folder(tmp_path):
    """Nothing is written anywhere, and the interrupt promises nothing."""
    with pytest.raises(KeyboardInterrupt) as caught:
        fit(simulator(Counted(2, interrupt)), DATA, config=TINY, quiet=True)
    assert str(caught.value) == ""


KILLED = """
import importlib.util, os, signal, sys
spec = importlib.util.spec_from_file_location(sys.argv[3], sys.argv[1])
same = importlib.util.module_from_spec(spec)
spec.loader.exec_module(same)
sys.modules["nfpde.estimation.run"].CHECKPOINT_SECONDS = 0.0
step = same.Counted(5, lambda: os.kill(os.getpid(), signal.SIGKILL))
same.fit(same.simulator(step), same.DATA, config=same.TINY, seed=2, out=sys.argv[2], quiet=True)
"""


def test_a_killed_fit_goes_on(tmp_path, uninterrupted):
    """A process killed without warning in its fourth iteration: the same call ends in the same numbers."""
    done = subprocess.run([sys.executable, "-c", KILLED, __file__, tmp_path, __name__], env={**os.environ}, check=False)
    assert done.returncode == -signal.SIGKILL
    rest = Counted()
    result = fit(simulator(rest), DATA, config=TINY, seed=2, out=tmp_path, quiet=True)
    assert rest.calls == 1 + 2
    assert numbers(result) == numbers(uninterrupted)


def test_a_finished_run_is_read_back(tmp_path, uninterrupted):
    """Nothing is simulated but what tells the simulator, and everything is the same, seconds included."""
    first = fit(simulator(), DATA, config=TINY, seed=2, out=tmp_path, quiet=True)
    written = (tmp_path / "fit.json").read_bytes()
    again = fit(simulator(Counted(2, interrupt)), DATA, config=TINY, seed=2, out=tmp_path, quiet=True)
    assert numbers(again) == numbers(first) == numbers(uninterrupted)
    assert (tmp_path / "fit.json").read_bytes() == written


@pytest.mark.parametrize("method", ["softmax", "trajectory"])
def test_two_fits_into_one_folder_at_a_time_are_refused(tmp_path, method):
    """The second stops before it simulates anything; the first is left alone, and its folder is free afterwards."""
    with alone_in(tmp_path, "fitting"):
        text = f"^fitting in {re.escape(str(tmp_path))}: another process is at work there"
        with pytest.raises(BadInput, match=text):
            fit(simulator(Counted(1, interrupt)), DATA, method=method, out=tmp_path, quiet=True)
        assert [p.name for p in tmp_path.iterdir()] == [".lock"]
    fit(simulator(), DATA, config=replace(TINY, iterations=1), out=tmp_path, quiet=True)
    assert not (tmp_path / ".lock").exists()


def test_another_run_is_refused(tmp_path):
    """A folder belongs to one run; the message names what differs, with both values."""
    fit(simulator(), DATA, config=replace(TINY, iterations=1), out=tmp_path, quiet=True)
    narrow = ParameterSpace([Parameter("stiffness", low=1.0, high=8.0), SPACE[1]])
    same = {"config": replace(TINY, iterations=1), "seed": 0, "method": "softmax"}
    for changed, sim, data, texts in (
        ({"seed": 1}, simulator(), DATA, ["seed: saved 0, now 1"]),
        ({"method": "cai"}, simulator(), DATA, ['method: saved "softmax", now "cai"']),
        (
            {"config": replace(TINY, iterations=1, samples=30), "seed": 7},
            simulator(),
            DATA,
            ["config.samples: saved 20, now 30", "seed: saved 0, now 7"],
        ),
        ({}, simulator(), record(seed=1), [f'dataset: saved "{DATA.content_hash()}"']),
        ({}, simulator(space=narrow), DATA, ["space", "8.0"]),
        ({}, simulator(step=lambda x, u, xi: x), DATA, ["simulator.step: saved", "oscillator", "<lambda>"]),
    ):
        arguments: dict[str, Any] = {**same, **changed}
        with pytest.raises(CheckpointMismatch) as caught:
            fit(sim, data, **arguments, out=tmp_path, quiet=True)
        for text in (*texts, str(tmp_path), "another folder to start afresh"):
            assert text in str(caught.value)


def test_results_on_the_disk(tmp_path, uninterrupted):
    """What is saved is what is loaded: both distributions to the last bit, history and facts."""
    uninterrupted.save(tmp_path / "new")
    assert numbers(FitResult.load(tmp_path / "new")) == numbers(uninterrupted)
    assert FitResult.load(tmp_path / "new").info == uninterrupted.info
    alone = nfpde.ParameterDistribution.load(tmp_path / "new" / "distribution", SPACE)
    assert alone.sample(9).tobytes() == uninterrupted.distribution.sample(9).tobytes()
    facts = uninterrupted.info
    assert facts["method"] == "softmax"
    assert facts["seed"] == 2
    assert facts["config"]["samples"] == 20
    assert ParameterSpace.from_json(facts["space"]) == SPACE
    assert facts["dataset"] == DATA.content_hash()
    assert {"nfpde", "mujoco", "torch", "zuko", "numpy"} == set(facts["versions"])


def test_damaged_results_are_refused(tmp_path, uninterrupted):
    """No folder, no JSON, another version, a distribution that is gone: each is named."""
    with pytest.raises(BadInput, match=r"fit\.json cannot be read .* is this the folder of a fit\?"):
        FitResult.load(tmp_path / "none")
    uninterrupted.save(tmp_path)
    whole = (tmp_path / "fit.json").read_text()
    for text, message in (
        (whole[:100], "is not JSON"),
        ("[]", "schema_version is None, this version of nfpde reads 1"),
        (whole.replace('"schema_version": 1', '"schema_version": 99'), "schema_version is 99"),
    ):
        (tmp_path / "fit.json").write_text(text)
        with pytest.raises(BadInput, match=message):
            FitResult.load(tmp_path)
    (tmp_path / "fit.json").write_text(whole)
    (tmp_path / "initial" / "distribution.json").unlink()
    with pytest.raises(BadInput, match="initial"):
        FitResult.load(tmp_path)


def test_scales(monkeypatch):
    """`increment` divides errors by what each channel changes by, `unit` by one."""
    seen = []
    plain = CallableSimulator.losses

    def watched(self, xi, windows, scale):
        seen.append(scale)
        return plain(self, xi, windows, scale)

    monkeypatch.setattr(CallableSimulator, "losses", watched)
    for scale in ("increment", "unit"):
        fit(simulator(), DATA, config=replace(TINY, iterations=1, scale=scale), quiet=True)
    np.testing.assert_array_equal(seen[0], increment_scale(simulator().states, DATA.transitions()))
    np.testing.assert_array_equal(seen[1], [1.0, 1.0])


def test_what_does_not_fit_is_refused():
    """Recordings of another robot, windows longer than any episode, unknown methods, seeds that are none."""
    two = Dataset([Episode("a", [0, 1], np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 1)))])
    with pytest.raises(BadDataset, match=r"the data has nq=2, nv=2, the simulator nq=1, nv=1: qpos x, qvel v"):
        fit(simulator(), two, config=TINY)
    with pytest.raises(BadDataset, match="16"):
        fit(simulator(), DATA, config=replace(TINY, horizon=16))
    with pytest.raises(BadInput, match="no method is called 'em'; there are: softmax, cai"):
        fit(simulator(), DATA, method="em")  # type: ignore[arg-type]
    for seed in (-1, 1.0, True, "0", 2**63):
        with pytest.raises(BadInput, match=f"seed is {seed!r}; it must be an integer from 0 to 9223372036854775807"):
            fit(simulator(), DATA, seed=seed)  # type: ignore[arg-type]


def test_nothing_moves():
    """A robot at rest says nothing about its parameters."""
    still = Dataset([Episode("a", [0, 1, 2], np.ones((3, 1)), np.zeros((3, 1)), np.zeros((3, 1)))])
    with pytest.raises(BadDataset, match="nothing moves"):
        fit(simulator(), still, config=TINY)
