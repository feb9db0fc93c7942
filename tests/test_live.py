"""Effects inside an environment that has forces and a solver of its own."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.mujoco import MujocoEnv

from nfpde.effects import effect
from nfpde.errors import BadEffect
from nfpde.live import LivePhysics
from nfpde.parameters import ParameterSpace
from nfpde.sim import load_model
from tests.effect_checks import SERVO_ARM
from tests.models import load, plain_rollout

PUSH = np.array([0.0, 20.0, 5.0, 0.0, 1.0, 0.0])
"""Force and torque of the environment itself on the hand [N], [Nm]."""

PUSHED, TORQUE = 3, np.array([0.0, 0.3, 0.0])
STEPS = 4


class Pushing(MujocoEnv):
    """The arm; a test pushes it through the environment's data."""

    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"], "render_fps": 125}  # noqa: RUF012

    def __init__(self, path: str) -> None:
        super().__init__(path, STEPS, gymnasium.spaces.Box(-9, 9, (6,)))

    def reset_model(self):
        self.set_state(self.init_qpos, self.init_qvel)
        return self._get_obs()

    def _get_obs(self):
        return np.concatenate([self.data.qpos, self.data.qvel])


@pytest.fixture
def arm(tmp_path):
    """Makes the environment with options of the model."""

    def make(options=""):
        path = tmp_path / "arm.xml"
        path.write_text(SERVO_ARM.replace('timestep="0.002"', f'timestep="0.002" {options}'))
        env = Pushing(str(path))
        env.reset(seed=0)
        return env

    return make


def pushed(model, data):
    data.xfrc_applied[PUSHED], data.qfrc_applied[:] = PUSH, TORQUE


@pytest.mark.parametrize(
    ("given", "xi"),
    [
        (("joint_spring", "elbow", {"stiffness": (0, 9), "rest": (-1, 1)}), [6.0, 0.4]),
        (("external_force", "hand", {f"force_{a}": (-50, 50) for a in "xyz"}), [3.0, -8.0, 2.0]),
        (("stribeck_friction", "elbow", {"coulomb": (0, 5), "static": (0, 5), "speed": (0.01, 1)}), [0.1, 0.2, 0.1]),
        (("actuation_delay", "*", {"delay": (0, 0.1)}), [0.003]),
    ],
    ids=lambda v: v[0] if isinstance(v, tuple) else "",
)
def test_what_the_environment_itself_pushes_stays(arm, given, xi):
    """Its forces and those of an effect add up, in every physics step, and are its own again afterwards."""
    name, target, bounds = given
    env = arm()
    chosen: Any = effect(name, target, **bounds)
    physics = LivePhysics(env, ParameterSpace(chosen.parameters))
    model = load_model(load(SERVO_ARM))

    def both(m, d):
        pushed(m, d)
        if name == "joint_spring":
            d.qfrc_applied[1] += -xi[0] * (d.qpos[1] - xi[1])
        elif name == "external_force":
            d.xfrc_applied[PUSHED, :3] += xi
        elif name == "stribeck_friction":
            m.dof_frictionloss[1] = xi[0] + (xi[1] - xi[0]) * np.exp(-((d.qvel[1] / xi[2]) ** 2))

    for value in (xi, None):
        physics.write(None if value is None else np.array(value))
        env.reset(seed=0)
        pushed(env.model, env.data)
        physics.start()
        ctrl = np.array([0.3, -0.2, 0.1])
        start = np.concatenate([env.data.qpos, env.data.qvel])
        for _ in range(3):
            env.do_simulation(ctrl, STEPS)
            np.testing.assert_array_equal(env.data.xfrc_applied[PUSHED], PUSH)
            np.testing.assert_array_equal(env.data.qfrc_applied, TORQUE)
        expected = plain_rollout(load_model(load(SERVO_ARM)), start, np.tile(ctrl, (3, 1)), STEPS, pushed)[-1]
        if value is not None:  # a delay of a command that has been the same for ever does nothing
            expected = plain_rollout(model, start, np.tile(ctrl, (3, 1)), STEPS, both)[-1]
        np.testing.assert_allclose(np.concatenate([env.data.qpos, env.data.qvel]), expected, atol=1e-12)


def test_a_refused_environment_is_left_as_it_is(arm, monkeypatch):
    """Its solver too, whatever the reason."""
    env = arm('solver="PGS"')
    own = env.model.opt.solver, env.model.opt.disableflags
    play = ParameterSpace(effect("backlash_command", "shoulder_servo", width=(0, 0.3)).parameters)
    with pytest.raises(BadEffect, match="remembers commands of any age"):
        LivePhysics(env, play)
    assert (env.model.opt.solver, env.model.opt.disableflags) == own
    monkeypatch.setattr(Pushing, "_get_obs", lambda env: np.array(env.data.qfrc_bias))
    shifted = ParameterSpace(effect("joint_offset", "elbow", offset=(-1, 1)).parameters)
    with pytest.raises(BadEffect, match="its observation holds more than"):
        LivePhysics(env, shifted)
    assert (env.model.opt.solver, env.model.opt.disableflags) == own


def test_an_accepted_environment_gets_its_solver_back(arm):
    """While parameters are written it has the simulator's."""
    env = arm('solver="PGS"')
    own = env.model.opt.solver, env.model.opt.disableflags
    damped = ParameterSpace(effect("viscous_damping", "elbow", damping=(0, 1)).parameters)
    physics = LivePhysics(env, damped)
    assert env.model.opt.solver == physics.nominal_model.opt.solver != own[0]
    physics.release()
    assert (env.model.opt.solver, env.model.opt.disableflags) == own
