"""Environments that carry something over from one episode to the next are refused, in training and in evaluations."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import (
    DelayObservation,
    FrameStackObservation,
    NormalizeObservation,
    NormalizeReward,
    TimeAwareObservation,
)

from nfpde.errors import BadInput
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import RandomizedParameters, SacConfig, TrainResult, evaluate_policy, make_environment, train_sac
from nfpde.rl.tasks import TASKS

SPACE = ParameterSpace([Parameter("body_mass", "pendulum", 0.4, 1.6)])
SMALL = SacConfig(hidden=(8,), batch_size=8, learning_starts=10, buffer_size=1000, train_every=10)


class Centred(gymnasium.ObservationWrapper):
    """Takes the mean of all observations so far away, with numbers of its own."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.total, self.count = np.zeros(3), 0

    def observation(self, observation: Any) -> Any:
        self.total, self.count = self.total + observation, self.count + 1
        return observation - self.total / self.count


class Harder(gymnasium.Wrapper):
    """A curriculum: every episode that ends makes rewards smaller."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.ended = 0

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.ended += terminated or truncated
        return observation, float(reward) / (1 + 0.1 * (self.ended > self.patience)), terminated, truncated, info

    patience = 0


class Later(Harder):
    """The same, but not before training has gone on for a while."""

    patience = 4


class Noisy(gymnasium.ObservationWrapper):
    """Noise of a generator of its own, which no reset seeds."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.rng = np.random.default_rng(0)

    def observation(self, observation: Any) -> Any:
        return observation + 0.01 * self.rng.standard_normal(3)


class Seeded(gymnasium.ObservationWrapper):
    """Noise of the environment's generator, which every reset seeds."""

    def observation(self, observation: Any) -> Any:
        return observation + 0.01 * self.np_random.standard_normal(3)


def short() -> gymnasium.Env:
    return gymnasium.make("nfpde/Pendulum-v0", max_episode_steps=30)


def frozen() -> gymnasium.Env:
    """Normalized by fixed statistics."""
    env = NormalizeObservation(short())
    env.obs_rms.mean, env.obs_rms.var = np.array([0.1, 0.0, 0.5]), np.array([0.5, 0.5, 4.0])
    env.update_running_mean = False
    return env


def train(maker: Any, out: Any, steps: int = 60) -> TrainResult:
    return train_sac(
        maker, [[0.7], [1.0]], space=SPACE, steps=steps, out=out, target=[[0.8]], evaluation_every=30,
        evaluation_episodes=2, hyperparameters=SMALL, device="cpu", quiet=True,
    )  # fmt: skip


def push(observation: Any) -> Any:
    return 1.5 * np.sign(np.ravel(observation)[2:3])


@pytest.mark.parametrize(("wrapper", "kept"), [(NormalizeObservation, "obs_rms"), (NormalizeReward, "return_rms")])
def test_running_statistics_are_refused(tmp_path, wrapper, kept):
    """Before anything runs: the message names the wrapper and what to use in its place."""
    text = rf"Pendulum-v0: {wrapper.__name__} scales by statistics .*\({kept}\).*fixed numbers.*TransformObservation"
    with pytest.raises(BadInput, match=text):
        train(lambda: wrapper(short()), tmp_path)
    assert not list(tmp_path.iterdir())
    with pytest.raises(BadInput, match=text):
        evaluate_policy(push, lambda: wrapper(short()), [[0.7]], space=SPACE, episodes=2)
    env = RandomizedParameters(wrapper(short()), [[0.7]], SPACE)
    with pytest.raises(BadInput, match=text):
        evaluate_policy(push, env, episodes=2)


@pytest.mark.parametrize("wrapper", [Centred, Harder, Noisy])
def test_whatever_is_carried_over_is_refused(tmp_path, wrapper):
    """Found by what it does: equal seeds and actions give another episode once others have run."""
    text = (
        rf"Pendulum-v0 \(its wrappers: {wrapper.__name__}\) carries something over from one episode to the next: "
        r".* was [\d.e-]+ at first and [\d.e-]+ after others had run.*np_random"
    )
    with pytest.raises(BadInput, match=text):
        train(lambda: wrapper(short()), tmp_path)
    assert not (tmp_path / "state.safetensors").exists()
    with pytest.raises(BadInput, match=text):
        evaluate_policy(push, lambda: wrapper(short()), [[0.7]], space=SPACE, episodes=2)


def test_a_change_during_training_is_found(tmp_path):
    """An environment that changes only after a while: no later round is saved."""
    with pytest.raises(BadInput, match=r"Later.* carries something over"):
        train(lambda: Later(short()), tmp_path, 300)


def test_memory_within_an_episode_is_no_matter(tmp_path):
    """Stacks, delays, clocks and noise that a reset starts afresh repeat."""
    for i, maker in enumerate((
        lambda: gymnasium.wrappers.FlattenObservation(FrameStackObservation(short(), 3)),
        lambda: DelayObservation(short(), 2),
        lambda: TimeAwareObservation(short()),
        lambda: Seeded(short()),
    )):  # fmt: skip
        assert train(maker, tmp_path / str(i), 30).after.step == 30
        first, second = (evaluate_policy(push, maker, [[0.7]], space=SPACE, episodes=2) for _ in range(2))
        np.testing.assert_array_equal(first.returns, second.returns)


def test_fixed_statistics_keep_the_promises(tmp_path):
    """Normalized by numbers that stay: interrupted equals uninterrupted, and an evaluation elsewhere is the same."""
    train(frozen, tmp_path / "a", 30)
    first, second = train(frozen, tmp_path / "a", 90), train(frozen, tmp_path / "b", 90)
    assert first.points == second.points
    for name, weight in first.policy.weights.items():
        np.testing.assert_array_equal(weight, second.policy.weights[name])
    elsewhere = evaluate_policy(first.policy, frozen, [[0.8]], space=SPACE, episodes=2)
    assert first.after.target is not None
    assert elsewhere.mean == first.after.target.mean


@pytest.mark.parametrize("name", TASKS)
def test_the_tasks_repeat(name):
    """None of the environments that have a short name is refused, after whole episodes of random actions."""
    env = make_environment(name)
    bare: Any = env.unwrapped
    space = ParameterSpace([Parameter("body_mass", "#1", 0.5, 20.0)])
    wrapped = RandomizedParameters(gymnasium.wrappers.TimeLimit(env, 200), None, space)
    bare.action_space.seed(1)
    assert len(evaluate_policy(lambda o: bare.action_space.sample(), wrapped, episodes=3).returns) == 3
