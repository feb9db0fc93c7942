"""A training goes on in the environment that it began in, and in no other."""

from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.mujoco.hopper_v5 import HopperEnv
from gymnasium.wrappers import RecordEpisodeStatistics, RescaleAction, TimeLimit, TransformReward

from nfpde.benchmarks.pendulum import Pendulum
from nfpde.checkpoint import load_state, save_state
from nfpde.errors import BadInput, CheckpointMismatch
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import RandomizedParameters, SacConfig, TrainResult, train_sac
from nfpde.rl.behaviour import difference, observe
from nfpde.rl.settings import environment_settings

PENDULUM = ParameterSpace([Parameter("body_mass", "pendulum", 0.4, 1.6)])
HOPPER = ParameterSpace([Parameter("body_mass", "thigh", 2.0, 6.0)])
SMALL = SacConfig(hidden=(8,), batch_size=8, learning_starts=10, buffer_size=1000, train_every=10)

Maker = Callable[[], gymnasium.Env]


class Worth(gymnasium.RewardWrapper):
    """Rewards times a factor."""

    def __init__(self, env: gymnasium.Env, factor: float) -> None:
        super().__init__(env)
        self.factor = factor

    def reward(self, reward: Any) -> float:
        return self.factor * float(reward)


class Fast(gymnasium.Wrapper):
    """Ends an episode that is faster than a limit [rad/s]."""

    def __init__(self, env: gymnasium.Env, limit: float) -> None:
        super().__init__(env)
        self.limit = limit

    def step(self, action: Any) -> Any:
        observation, reward, over, *rest = self.env.step(action)
        return observation, reward, over or abs(observation[2]) > self.limit, *rest


class Near(Pendulum):
    """Starts within an angle of hanging [rad]."""

    within = 1.0

    def reset_model(self) -> Any:
        self.set_state(self.within * self.np_random.uniform(-1, 1, 1), np.zeros(1))
        return self._get_obs()


class Nearer(Pendulum):
    """The same under another class, with another angle."""

    def reset_model(self) -> Any:
        self.set_state(0.9 * self.np_random.uniform(-1, 1, 1), np.zeros(1))
        return self._get_obs()


Nearer.__name__ = "Near"


def pendulum(*wrappers: Callable[[gymnasium.Env], gymnasium.Env], **arguments: Any) -> Maker:
    def make() -> gymnasium.Env:
        env = gymnasium.make("nfpde/Pendulum-v0", **{"max_episode_steps": 30, **arguments})
        for wrapper in wrappers:
            env = wrapper(env)
        return env

    return make


def hopper(**arguments: Any) -> Maker:
    return lambda: gymnasium.make("Hopper-v5", max_episode_steps=20, **arguments)


def train(maker: Maker, out: Path, steps: int) -> TrainResult:
    hops = "hop" in type(maker().unwrapped).__name__.lower()
    space, xi = (HOPPER, [[3.0], [5.0]]) if hops else (PENDULUM, [[0.7], [1.0]])
    return train_sac(
        maker, xi, space=space, steps=steps, out=out, evaluation_every=30, evaluation_episodes=2,
        hyperparameters=SMALL, device="cpu", quiet=True,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [
        (pendulum(), pendulum(max_episode_steps=20), "max_episode_steps: saved 30, now 20"),
        (
            pendulum(lambda e: Worth(e, 1.0)),
            pendulum(lambda e: Worth(e, -100.0)),
            r"Pendulum-v0, reward of control step 1 in a test episode of seed 0: saved [\d.-]+, now [\d.-]+",
        ),
        (pendulum(), pendulum(lambda e: Worth(e, 1.0)), r'wrappers\[0\]\.name: saved "TimeLimit", now "Worth"'),
        (
            pendulum(lambda e: TransformReward(e, lambda r: 2 * float(r))),
            pendulum(lambda e: TransformReward(e, lambda r: 3 * float(r))),
            "reward of control step 1 ",
        ),
        (
            pendulum(lambda e: RescaleAction(e, np.float32(-1), np.float32(1))),
            pendulum(lambda e: RescaleAction(e, np.float32(-2), np.float32(2))),
            r"wrappers\[0\]\.arguments\.max_action: saved 1\.0, now 2\.0",
        ),
        (
            pendulum(lambda e: Fast(e, 100.0)),
            pendulum(lambda e: Fast(e, 1.0)),
            r"control steps in a test episode of seed 0: saved 30, now \d+",
        ),
        (
            lambda: TimeLimit(Near(), 30),
            lambda: TimeLimit(Nearer(), 30),
            r"environment Near, observation\[0\] after 0 control steps in a test episode of seed 0: saved",
        ),
        (hopper(), hopper(forward_reward_weight=5.0), r"arguments\.forward_reward_weight: saved nothing, now 5\.0"),
        (
            hopper(healthy_z_range=(0.7, 9.0)),
            hopper(healthy_z_range=(0.6, 9.0)),
            r"arguments\.healthy_z_range\[0\]: saved 0\.7, now 0\.6",
        ),
        (
            hopper(reset_noise_scale=0.005),
            hopper(reset_noise_scale=0.1),
            r"arguments\.reset_noise_scale: saved 0\.005, now 0\.1",
        ),
        (
            lambda: TimeLimit(HopperEnv(healthy_z_range=(0.7, 9.0)), 20),
            lambda: TimeLimit(HopperEnv(healthy_z_range=(0.6, 9.0)), 20),
            r"arguments\.unnamed\[\d\]\[0\]: saved 0\.7, now 0\.6",
        ),
    ],
    ids=[
        "length", "worth", "another wrapper", "a function", "scale of actions", "end", "start", "reward weight",
        "healthy range", "noise of resets", "without a spec",
    ],
)  # fmt: skip
def test_another_environment_is_refused(tmp_path, before, after, text):
    """The message names what differs, and what to do; the first environment still goes on."""
    train(before, tmp_path, 30)
    with pytest.raises(CheckpointMismatch, match=rf"(?s)was saved by another run:\n.*{text}.*to go on.*another folder"):
        train(after, tmp_path, 60)
    assert train(before, tmp_path, 60).after.step == 60


def test_spaces_are_compared(tmp_path):
    """Bounds of actions, in an environment whose arguments and wrappers are the same."""

    def maker(top: float) -> Maker:
        def make() -> gymnasium.Env:
            bare: Any = Near()
            bare.action_space = gymnasium.spaces.Box(-top, top, (1,))
            return TimeLimit(bare, 30)

        return make

    train(maker(1.5), tmp_path, 30)
    with pytest.raises(CheckpointMismatch, match=r"action_space\.high: saved 1\.5, now 1\.0"):
        train(maker(1.0), tmp_path, 60)


def test_what_only_looks_on_may_change(tmp_path):
    """Sizes of pictures and wrappers that count or draw leave the task as it is."""
    train(pendulum(), tmp_path / "a", 60)
    train(pendulum(), tmp_path / "b", 30)
    seen = pendulum(RecordEpisodeStatistics, width=99, render_mode="rgb_array", disable_env_checker=False)
    second = train(seen, tmp_path / "b", 60)
    first = train(pendulum(), tmp_path / "a", 60)
    assert second.points == first.points
    for name, weight in first.policy.weights.items():
        np.testing.assert_array_equal(weight, second.policy.weights[name])


def test_a_training_of_an_earlier_version_is_refused(tmp_path):
    """Its settings said less of the environment: the message says so, not that every one of them is new."""
    train(pendulum(), tmp_path, 30)
    saved = load_state(tmp_path)
    assert saved is not None
    tensors, info = saved
    save_state(tmp_path, tensors, {**info, "run": {**info["run"], "schema_version": 1}})
    with pytest.raises(CheckpointMismatch, match=r"saved by another version of nfpde .*: train in another folder$"):
        train(pendulum(), tmp_path, 60)


def test_a_round_holds_an_episode_of_any_environment(tmp_path):
    """The limit counts too where no Gymnasium id says it."""
    with pytest.raises(BadInput, match="evaluation_every is 30; it must be at least an episode of Near, 31 control"):
        train(lambda: TimeLimit(Near(), 31), tmp_path, 30)


def test_rounding_is_no_difference():
    """Of single precision, or of another processor: only what is larger counts."""
    env = RandomizedParameters(pendulum()(), [0.7], PENDULUM)
    first = observe(env, np.array([0.7]))
    assert difference(first, observe(env, np.array([0.7]))) is None
    for factor, found in ((1 + 1e-7, False), (1 + 1e-5, True)):
        second = deepcopy(first)
        second["episodes"][1]["rewards"] = factor * first["episodes"][1]["rewards"]
        second["episodes"][1]["observations"] = [factor * o for o in first["episodes"][1]["observations"]]
        assert (difference(first, second) is not None) == found


def test_large_bounds_are_fingerprints():
    """Spaces of hundreds of different bounds stay one line of the settings, and no two the same."""

    def settings(change: float) -> dict[str, Any]:
        env = RandomizedParameters(gymnasium.make("Humanoid-v5"), None, ParameterSpace(
            [Parameter("body_mass", "torso", 4.0, 12.0)]
        ))  # fmt: skip
        low = np.arange(-500.0, -152.0)
        low[7] += change
        env.observation_space = gymnasium.spaces.Box(low, np.inf, (348,), np.float64)
        return environment_settings(env)["observation_space"]

    first, second = settings(0.0), settings(1e-6)
    assert settings(0.0) == first
    assert first["low"] != second["low"]
    assert len(first["low"]) < 50
    assert first["high"] == "inf"
