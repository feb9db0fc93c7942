"""Environments that step, or look, past the methods through which effects act: refused, not believed."""

from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.envs.mujoco.hopper_v5 import HopperEnv

from nfpde.effects import effect
from nfpde.errors import BadEffect, BadInput
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import RandomizedParameters

MASS = ParameterSpace([Parameter("body_mass", "thigh", 2.0, 6.0)])
LATE = ParameterSpace(effect("actuation_delay", "*", delay=(0.0, 0.05)).parameters)
SHIFTED = ParameterSpace(effect("joint_offset", "leg_joint", offset=(-1.0, 1.0)).parameters)


class ByItself(HopperEnv):
    """Calls MuJoCo without `do_simulation`."""

    def step(self, action: Any) -> Any:
        self.data.ctrl[:] = action
        mujoco.mj_step(self.model, self.data, self.frame_skip)
        return self._get_obs(), 0.0, False, False, {}


class Inline(HopperEnv):
    """Builds the observation of a step without `_get_obs`."""

    def step(self, action: Any) -> Any:
        self.do_simulation(action, self.frame_skip)
        return np.concatenate([self.data.qpos[1:], self.data.qvel]), 0.0, False, False, {}


class InlineReset(HopperEnv):
    """The same of a reset."""

    def reset_model(self) -> Any:
        self.set_state(self.init_qpos, self.init_qvel)
        return np.concatenate([self.data.qpos[1:], self.data.qvel])


class Parts(HopperEnv):
    """Positions and velocities apart; on request with forces, or with what fails."""

    more = ""

    def _get_obs(self) -> Any:
        parts = {"qvel": self.data.qvel.copy(), "qpos": (self.data.qpos[:2].copy(), self.data.qpos[2:].copy())}
        if self.more == "forces":
            parts["forces"] = self.data.qfrc_actuator.copy()
        if self.more == "fails" and np.abs(self.data.qfrc_actuator).max() > 0:
            raise ZeroDivisionError
        return parts

    def step(self, action: Any) -> Any:
        self.do_simulation(action, self.frame_skip)
        return self._get_obs(), 0.0, False, False, {}

    def reset(self, **arguments: Any) -> Any:
        gymnasium.Env.reset(self, seed=arguments.get("seed"))
        self.set_state(self.init_qpos, self.init_qvel)
        return self._get_obs(), {}


@pytest.mark.parametrize(("space", "error"), [(MASS, BadInput), (LATE, BadEffect)], ids=["mass", "delay"])
def test_a_step_past_the_simulation(space, error):
    """Delays would do nothing, and numbers of a simulation that blew up would pass for a robot's."""
    env = RandomizedParameters(ByItself(), space.low, space)
    env.reset(seed=0)
    text = r"^environment ByItself: its step\(\) made no call of do_simulation, .*; let every step call self.do_sim.*$"
    for _ in range(2):
        with pytest.raises(error, match=text):
            env.step(np.zeros(3))
    env.release()
    assert not {"step", "do_simulation"} & set(vars(env.unwrapped))
    env.unwrapped.step(np.zeros(3))


def test_a_step_past_the_sensors():
    """An offset would show after a reset and not after a step; effects elsewhere act as they should."""
    env = RandomizedParameters(Inline(), [0.2], SHIFTED)
    assert env.reset(seed=0)[0][3] - env.unwrapped.data.qpos[4] == pytest.approx(0.2)  # type: ignore[attr-defined]
    text = r"Inline: its step\(\) made no call of _get_obs, .*\(joint_offset\); let it return .*self._get_obs\(\) gives"
    with pytest.raises(BadEffect, match=text):
        env.step(np.zeros(3))
    env = RandomizedParameters(Inline(), [0.02], LATE)
    env.reset(seed=0)
    env.step(np.zeros(3))


def test_a_reset_past_the_sensors():
    """Nor may the offset show after a step only."""
    with pytest.raises(BadEffect, match=r"InlineReset: its reset\(\) made no call of _get_obs"):
        RandomizedParameters(InlineReset(), [0.2], SHIFTED).reset(seed=0)


def test_a_wrapper_may_leave_steps_out():
    """What does not reach the environment simulates nothing, and nothing is wrong with that."""

    class Idle(gymnasium.Wrapper):
        def step(self, action: Any) -> Any:
            return self.env.reset()[0], 0.0, False, False, {}

    env = RandomizedParameters(Idle(HopperEnv()), [0.2], SHIFTED)
    env.reset(seed=0)
    env.step(np.zeros(3))


def test_observations_in_parts():
    """Sensors are off in the part that has them, after a reset and after a step."""
    env: Any = RandomizedParameters(Parts(), [0.2], SHIFTED)
    data = env.unwrapped.data
    for act in (lambda: env.reset(seed=0), lambda: env.step(np.full(3, 0.5))):
        seen = act()[0]
        np.testing.assert_allclose(np.concatenate(seen["qpos"]) - data.qpos, 0.2 * (np.arange(6) == 4), atol=1e-12)
        np.testing.assert_array_equal(seen["qvel"], data.qvel)


@pytest.mark.parametrize(("more", "error"), [("forces", BadEffect), ("fails", ZeroDivisionError)])
def test_what_is_refused_is_as_it_was(more, error):
    """State, methods and solver, whatever the trial of its observation came to."""
    env: Any = Parts()
    env.reset(seed=0)
    env.more = more
    options = env.model.opt
    before = env.state_vector(), options.solver, options.disableflags
    with pytest.raises(error, match="holds more than qpos and qvel" if more == "forces" else None):
        RandomizedParameters(env, [0.2], SHIFTED)
    np.testing.assert_array_equal(env.state_vector(), before[0])
    assert (options.solver, options.disableflags) == before[1:]
    assert not {"step", "do_simulation", "_get_obs"} & set(vars(env))
    assert not env.data.qfrc_actuator.any()
