"""What environments do in their reset, divergences that stay quiet, and folders that cannot be made."""

from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

from nfpde.benchmarks.pendulum import Pendulum
from nfpde.effects import effect
from nfpde.errors import SimulationDiverged
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import RandomizedParameters, SacConfig, train_sac
from nfpde.rl.learner import SacLearner

MASS = Parameter("body_mass", "pendulum", 0.4, 1.6)
DELAY = effect("actuation_delay", "motor", delay=(0.0, 0.1))
STRIBECK = effect("stribeck_friction", "hinge", coulomb=(0.0, 2.0), static=(0.0, 4.0), speed=(0.05, 1.0))
PLAIN = ParameterSpace([MASS])
DELAYED = ParameterSpace([MASS, *DELAY.parameters])


class Settling(Pendulum):
    """Rests for three control steps before an episode."""

    def reset_model(self) -> Any:
        super().reset_model()
        for _ in range(3):
            self.do_simulation(np.zeros(1), self.frame_skip)
        return self._get_obs()


class Exploding(Pendulum):
    """Blows up in its reset from the second one on."""

    resets = 0

    def reset_model(self) -> Any:
        super().reset_model()
        self.resets += 1
        if self.resets > 1:
            self.data.qvel[:] = 1e11
            self.do_simulation(np.zeros(1), self.frame_skip)
        return self._get_obs()


class Warned(Pendulum):
    """MuJoCo warns of one command in its reset, which is over before the episode begins."""

    def reset_model(self) -> Any:
        super().reset_model()
        self.data.ctrl[0] = np.nan
        mujoco.mj_step(self.model, self.data)
        self.data.ctrl[0] = 0.0
        return self._get_obs()


class Seeking(Pendulum):
    """Observes a goal beside its state, which a reset draws."""

    goal: float

    def reset_model(self) -> Any:
        self.goal = float(self.np_random.uniform(-1, 1))
        return super().reset_model()

    def _get_obs(self) -> Any:
        return np.append(super()._get_obs(), self.goal)


def randomized(env: gymnasium.Env, xi: list[float], space: ParameterSpace) -> RandomizedParameters:
    return RandomizedParameters(gymnasium.wrappers.TimeLimit(env, 50), xi, space)


def test_an_environment_that_settles_in_its_reset_runs_under_effects():
    """Every reset ends in the same state for a seed, whatever was commanded in the episode before."""
    env = randomized(Settling(), [1.0, 0.08], DELAYED)
    first, _ = env.reset(seed=0)
    for _ in range(5):
        env.step(np.full(1, 2.0, np.float32))
    again, _ = env.reset(seed=0)
    np.testing.assert_array_equal(again, first)
    # a command of zero that is late is a command of zero
    plain, _ = randomized(Settling(), [1.0], PLAIN).reset(seed=0)
    np.testing.assert_allclose(first, plain, rtol=0, atol=1e-12)


def test_settling_leaves_no_trace_in_the_model():
    """Friction that an effect adds from step to step is added to the model's own when the episode begins."""
    space = ParameterSpace([MASS, *STRIBECK.parameters])
    rows = []
    for kind in (Pendulum, Settling):
        env = randomized(kind(), [1.0, 0.3, 0.6, 0.5], space)
        env.reset(seed=0)
        bare: Any = env.unwrapped
        bare.set_state(np.array([0.3]), np.array([1.5]))
        rows.append([env.step(np.full(1, 2.0, np.float32))[0] for _ in range(4)])
    np.testing.assert_allclose(rows[0], rows[1], rtol=0, atol=1e-12)


def test_a_divergence_within_a_reset_names_its_parameters():
    """An error of this package; the next reset that is sound works."""
    bare = Exploding()
    env = randomized(bare, [1.0], PLAIN)
    env.reset(seed=0)
    with pytest.raises(SimulationDiverged, match=r"Exploding: .* within reset\(\) .*'body_mass:pendulum': 1\.0"):
        env.reset(seed=0)
    bare.resets = 0
    env.reset(seed=0)
    assert "diverged" not in env.step(np.zeros(1, np.float32))[4]


def test_a_warning_of_the_reset_hides_no_divergence():
    """MuJoCo counts warnings from 0 again when a simulation blows up; one that was there before is none of the step."""
    env = randomized(Warned(), [1.0], PLAIN)
    bare: Any = env.unwrapped
    env.reset(seed=0)
    assert "diverged" not in env.step(np.zeros(1, np.float32))[4]
    env.reset(seed=0)
    bare.data.qvel[:] = 1e11
    assert env.step(np.zeros(1, np.float32))[4]["diverged"]


def test_an_observation_may_hold_what_a_reset_draws():
    """Sensor effects act beside it, and the environment's own draws come in the order that they had without us."""
    space = ParameterSpace([MASS, *effect("joint_offset", "hinge", offset=(-0.1, 0.1)).parameters])
    randomized(Seeking(), [1.0, 0.05], space)  # was never reset
    bare, other = Seeking(), Seeking()
    for env in (bare, other):
        env.reset(seed=3)
    wrapped = randomized(other, [1.0, 0.05], space)
    for _ in range(2):
        assert wrapped.reset()[0][-1] == bare.reset()[0][-1]


def test_divergences_write_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    """They are told by `info`; MuJoCo's lines on the console and MUJOCO_LOG.TXT in the user's folder say no more."""
    monkeypatch.chdir(tmp_path)
    for space, xi in ((PLAIN, [1.0]), (DELAYED, [1.0, 0.05])):
        env = randomized(Pendulum(), xi, space)
        env.reset(seed=0)
        bare: Any = env.unwrapped
        bare.data.qvel[:] = 1e11
        assert env.step(np.zeros(1, np.float32))[4]["diverged"]
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_told_before_a_round(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Not after hours of training that nothing is left of."""
    (tmp_path / "file").touch()
    rounds = []
    monkeypatch.setattr(SacLearner, "run_round", lambda *_: rounds.append(1))
    config = SacConfig(hidden=(8,), batch_size=8, learning_starts=10)
    with pytest.raises(OSError, match="file"):
        train_sac(
            "pendulum", [1.0], space=PLAIN, steps=160, evaluation_every=160, evaluation_episodes=2,
            out=tmp_path / "file" / "policy", hyperparameters=config, device="cpu", quiet=True,
        )  # fmt: skip
    assert not rounds
