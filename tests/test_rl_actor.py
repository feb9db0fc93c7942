"""Policies of any kind at work: agents without exploration, recurrent ones, and actions that nobody can take."""

import json
from dataclasses import asdict
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import SAC

from nfpde import live as physics
from nfpde.errors import BadInput, SimulationDiverged
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import Policy, RandomizedParameters, SacConfig, TrainResult, evaluate_policy, make_environment, train_sac
from nfpde.rl.learner import SacLearner

NUMPY: Any = np  # its numbers are no `int` to a type checker
SPACE = ParameterSpace([Parameter("body_mass", "pendulum", 0.4, 1.6)])
SMALL = SacConfig(hidden=(8,), batch_size=8, learning_starts=10, buffer_size=1000, train_every=10)


def evaluate(policy: Any, **change: Any) -> Any:
    return evaluate_policy(policy, "pendulum", **{"source": [[0.7]], "space": SPACE, "episodes": 2, **change})


def train(out: Any, **change: Any) -> TrainResult:
    arguments: dict[str, Any] = {
        "steps": 150,
        "evaluation_every": 150,
        "evaluation_episodes": 2,
        "hyperparameters": SMALL,
        "device": "cpu",
        "quiet": True,
    }
    return train_sac("pendulum", [[0.7]], space=SPACE, out=out, **{**arguments, **change})


def test_agents_act_without_exploration():
    """The same seed gives an agent of Stable-Baselines3 the same returns, those of its most likely actions."""
    torch.manual_seed(0)
    env = RandomizedParameters(make_environment("pendulum"), [[0.7]], SPACE)
    agent = SAC("MlpPolicy", env, seed=0, policy_kwargs={"net_arch": [8]}, buffer_size=100, device="cpu")
    first, second = evaluate(agent), evaluate(agent)
    np.testing.assert_array_equal(first.returns, second.returns)
    expected = evaluate(lambda o: agent.predict(o, deterministic=True)[0])
    np.testing.assert_array_equal(first.returns, expected.returns)


def test_recurrent_agents_keep_their_state():
    """What a policy returns beside its action comes back with the next observation; every episode begins afresh."""
    calls: list[tuple[Any, Any, bool]] = []

    class Recurrent:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            assert observation.shape == (3,)
            calls.append((state, episode_start, deterministic))
            return np.zeros(1, np.float32), (0 if state is None else state) + 1

    found = evaluate(Recurrent(), episodes=2)
    assert list(found.lengths) == [150, 150]
    assert [state for state, *_ in calls] == 2 * [None, *range(1, 150)]
    starts = np.array([start for _, start, _ in calls])
    assert starts.shape == (300, 1)  # one entry for each environment, of which there is one
    np.testing.assert_array_equal(np.flatnonzero(starts), [0, 150])
    assert all(deterministic for *_, deterministic in calls)


def test_other_policies_get_no_more_than_they_take():
    """A plain function, one that takes a state alone, one of NumPy's own: each is called by what it names."""
    states = []

    def with_state(observation, state=None):
        states.append(state)
        return np.zeros(1), len(states)

    evaluate(with_state)
    assert states[:3] == [None, 1, 2]
    evaluate(lambda *arguments: np.zeros(len(arguments)))
    evaluate(lambda state: -state[2:])  # the observation, whatever its name
    evaluate(lambda episode_start, deterministic: np.ones(1) * (deterministic and episode_start.shape == (3,)))
    evaluate(lambda observation, /, **rest: np.zeros(1 + len(rest)))
    with pytest.raises(BadInput, match=r"a policy has a method predict.* got a float"):
        evaluate(1.5)


@pytest.mark.parametrize("name", ["state", "episode_start", "deterministic"])
def test_the_first_argument_is_the_observation(name):
    """Under any name, of a method and of a function."""
    scope: dict[str, Any] = {}
    exec(f"def act({name}): return -{name}[2:]\ndef predict(self, {name}): return act({name})", scope)
    expected = evaluate(lambda o: -o[2:])
    for policy in (scope["act"], type("Acting", (), {"predict": scope["predict"]})()):
        np.testing.assert_array_equal(evaluate(policy).returns, expected.returns)


def test_actions_that_are_not_finite_are_the_policys_fault():
    """The message names the policy, not the simulation's timestep."""
    calls = []

    def breaks(observation):
        calls.append(observation)
        return np.array([0.1 if len(calls) < 5 else np.nan])

    text = (
        r"the policy gave the action \[nan\], which is not finite, after 4 control steps of an episode with "
        r"{'body_mass:pendulum': 0.7}: the fault is the policy's, not the simulation's"
    )
    with pytest.raises(BadInput, match=text):
        evaluate(breaks)
    with pytest.raises(BadInput, match=r"action \[inf\].*with nominal parameters"):
        evaluate(lambda o: np.array([np.inf]), source=None)
    # finite weights whose products are not: infinity less infinity
    weights = {"hidden.0.weight": np.full((2, 3), 1e30), "hidden.0.bias": np.full(2, 1e30)}
    weights |= {"mean.weight": np.array([[1e30, -1e30]]), "mean.bias": np.zeros(1)}
    weights |= {"log_std.weight": np.zeros((1, 2)), "log_std.bias": np.zeros(1)}
    huge = Policy(weights, np.array([-1], np.float32), np.array([1], np.float32))
    with pytest.raises(BadInput, match=r"the policy gave the action \[nan\], which is not finite$"):
        huge.predict(np.zeros(3))
    with pytest.raises(BadInput, match=r"action \[nan\].*the fault is the policy's"):
        evaluate(huge)


@pytest.mark.parametrize(
    ("action", "text"),
    [
        (np.zeros(3), r"gives actions of shape \(3,\), environment nfpde/Pendulum-v0 takes \(1,\): give the policy of"),
        (np.zeros((1, 1)), r"shape \(1, 1\)"),
        (0.5, r"shape \(\), environment"),
        (None, "the policy gives None for an action; it must be an array"),
        ("left", "the policy gives 'left' for an action; it must be an array of numbers"),
        ([[1.0], [1.0, 2.0]], "it must be an array of numbers"),
    ],
)
def test_actions_that_do_not_fit_are_refused(action, text):
    """Another number of actions, or no numbers at all."""
    with pytest.raises(BadInput, match=text):
        evaluate(lambda o: action)


def test_learning_that_blows_up_is_told_as_such(tmp_path):
    """The learning rate is named, and nobody is told that the same call would go on."""
    wild = SacConfig(hidden=(8,), batch_size=8, learning_starts=10, buffer_size=1000, learning_rate=1e20)
    text = (
        r"the learning blew up, not the simulation; use a smaller learning_rate \(it is 1e\+20\).*; nothing was saved$"
    )
    with pytest.raises(BadInput, match=text):
        train(tmp_path, hyperparameters=wild)
    assert not (tmp_path / "state.safetensors").exists()


@pytest.mark.parametrize("part", ["actor", "critic"])
def test_weights_that_are_not_finite_are_not_saved(tmp_path, monkeypatch, part):
    """They appear in the last update of a round: the state before it stays, and what to do is said."""
    train(tmp_path)
    before = (tmp_path / "state.safetensors").read_bytes()
    inner = SAC.train

    def spoiled(self, *arguments, **named):
        inner(self, *arguments, **named)
        if self.num_timesteps == 300:
            with torch.no_grad():
                next(iter(getattr(self, part).parameters())).fill_(float("nan"))

    monkeypatch.setattr(SAC, "train", spoiled)
    text = (
        r"weights of the networks are not finite after 300 control steps.*learning_rate \(it is 0\.0003\).*"
        r"holds the state after 150 control steps; other settings need another folder$"
    )
    with pytest.raises(BadInput, match=text):
        train(tmp_path, steps=300)
    assert (tmp_path / "state.safetensors").read_bytes() == before
    monkeypatch.setattr(SAC, "train", inner)
    assert train(tmp_path, steps=300).after.step == 300


def test_numbers_of_an_environment_that_are_not_finite_are_its_own_fault(tmp_path):
    """A reward or an observation of NaN: the environment is named, not the learning and not the simulation."""

    class Bad(gymnasium.Wrapper):
        def __init__(self, env, where):
            super().__init__(env)
            self.where, self.count = where, 0

        def reset(self, **arguments):
            self.count = 0
            return self.env.reset(**arguments)

        def step(self, action):
            observation, reward, terminated, truncated, info = self.env.step(action)
            self.count += 1
            if self.count == 120:  # beyond what the test episodes see
                observation, reward = (
                    (np.full(3, np.nan), reward) if self.where == "observation" else (observation, np.inf)
                )
            return observation, reward, terminated, truncated, info

    with pytest.raises(BadInput, match=r"Pendulum-v0: the reward is inf after 120 control steps of an episode with"):
        evaluate_policy(
            lambda o: np.zeros(1), lambda: Bad(make_environment("pendulum"), "reward"), [[0.7]], space=SPACE
        )
    for where in ("reward", "observation"):
        maker = (lambda kind: lambda: Bad(make_environment("pendulum"), kind))(where)
        with pytest.raises(BadInput, match=rf"{where}.* not finite|the reward is inf"):
            train_sac(maker, [[0.7]], space=SPACE, steps=150, out=tmp_path, evaluation_every=150,
                      evaluation_episodes=2, hyperparameters=SMALL, device="cpu", quiet=True)  # fmt: skip


@pytest.mark.parametrize("saved", [False, True])
def test_a_simulation_that_diverges_would_do_so_again(tmp_path, monkeypatch, saved):
    """The message says what is kept, and does not send anyone into the same call."""
    if saved:
        train(tmp_path)
    simulate, learn, learning = physics.LivePhysics._simulate, SacLearner.run_round, []

    def diverge(self, ctrl, n_frames):
        if learning:
            raise physics.PhysicsDiverged
        simulate(self, ctrl, n_frames)

    def run_round(self, *arguments):
        learning.append(True)
        return learn(self, *arguments)

    monkeypatch.setattr(physics.LivePhysics, "_simulate", diverge)
    monkeypatch.setattr(SacLearner, "run_round", run_round)
    kept = r".* holds the state after 150 control steps; other settings need another folder"
    with pytest.raises(SimulationDiverged, match=rf"tighter bounds; {kept if saved else 'nothing was saved'}$"):
        train(tmp_path, steps=300)


def test_numpy_integers_are_whole_numbers(tmp_path):
    """They train and evaluate as plain ones do, and settings hold plain ones."""
    steps, every, episodes = NUMPY.int64(150), NUMPY.int32(150), NUMPY.uint8(2)
    config = SacConfig(
        hidden=(NUMPY.int64(8),), batch_size=NUMPY.int32(8), learning_starts=NUMPY.int64(10),
        buffer_size=NUMPY.int64(1000), train_every=NUMPY.int16(10), tau=NUMPY.float32(0.25),
    )  # fmt: skip
    plain = SacConfig(hidden=(8,), batch_size=8, learning_starts=10, buffer_size=1000, train_every=10, tau=0.25)
    assert json.loads(json.dumps(asdict(config))) == json.loads(json.dumps(asdict(plain)))
    given = {"steps": steps, "evaluation_every": every, "evaluation_episodes": episodes, "threads": NUMPY.int64(1)}
    first = train(tmp_path / "a", **given, seed=NUMPY.int64(3), hyperparameters=config)
    second = train(tmp_path / "b", seed=3, hyperparameters=plain)
    assert first.points == second.points
    assert first.settings == second.settings
    assert len(evaluate(first.policy, episodes=NUMPY.int64(3), seed=NUMPY.int32(1)).returns) == 3


@pytest.mark.parametrize("value", [300.0, NUMPY.float64(300), True, NUMPY.bool_(True), "300", None, NUMPY.ones(1)])
def test_nothing_else_is_a_whole_number(tmp_path, value):
    """No fraction, no truth value, no text, no array."""
    with pytest.raises(BadInput, match=r"steps is .* must be a whole number, at least 1"):
        train(tmp_path, steps=value)
    with pytest.raises(BadInput, match=r"episodes is .* must be a whole number, at least 2"):
        evaluate(lambda o: o[2:], episodes=value)
    with pytest.raises(BadInput, match=r"SAC: batch_size is .* must be a whole number, at least 1"):
        SacConfig(batch_size=value)
