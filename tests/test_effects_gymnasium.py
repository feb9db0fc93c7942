"""Every effect in a Gymnasium environment moves the robot as it does in the simulator."""

import gymnasium
import numpy as np
import pytest

from nfpde.dataset import Windows
from nfpde.effects import DataScales, all_candidates, effect_names
from nfpde.rl import RandomizedParameters
from nfpde.sim import MujocoSimulator, load_model
from tests.models import record

STEPS = 8


OF_SERVOS = {"servo_gain", "joint_offset_logged", "sensor_scale_logged", "backlash_outer", "backlash_geared_outer"}
OF_SERVOS |= {"motor_strength_command", "motor_strength_gear", "backlash_command"}
"""Hopper has motors."""


@pytest.fixture(scope="module")
def hopper():
    """The environment's model, and a candidate of every effect that it can have."""
    model = load_model(gymnasium.make("Hopper-v5").unwrapped.model)  # pyright: ignore[reportAttributeAccessIssue]
    scales = DataScales.of(model, record(model, 1, 40, 4))
    found = {}
    for e in all_candidates(model, scales):
        if e.target in (None, "*", "thigh_joint", "foot_joint", "foot", "#2") or e.name not in found:
            found[e.name] = (e, e.screened(scales)[-1])
    return model, found


@pytest.mark.parametrize("name", sorted(set(effect_names()) - OF_SERVOS))
def test_an_effect_acts_in_an_environment_as_in_the_simulator(hopper, name):
    """States after every step of an episode, measured, from the same start under the same actions."""
    model, found = hopper
    effect, values = found[name]
    sim = MujocoSimulator(model, None, [effect], check_influence=False)
    env = RandomizedParameters(gymnasium.make("Hopper-v5", terminate_when_unhealthy=False), [values], sim.space)
    bare = env.unwrapped
    env.reset(seed=3)
    bound = sim.effects[0]

    def measured():
        true = np.concatenate([bare.data.qpos, bare.data.qvel])  # pyright: ignore[reportAttributeAccessIssue]
        return bound.to_measured(true[None], values[None])[0]

    states, actions = [measured()], np.random.default_rng(0).uniform(-1, 1, (STEPS, model.nu))
    for action in actions:
        _, _, _, truncated, _ = env.step(action)
        assert not truncated
        states.append(measured())
    control_dt = 4 * model.opt.timestep
    windows = Windows(
        state=np.array(states)[None],
        ctrl=actions[None],
        history=np.tile(actions[0], (1, sim.history_steps(control_dt), 1)),
        control_dt=control_dt,
        nq=model.nq,
        nv=model.nv,
        episode=np.zeros(1, int),
        row=np.zeros(1, int),
    )
    predicted = sim.predict([values], windows)[0, 0]
    # the same sums; encoders are taken off and put on again, and contacts multiply what that rounds
    np.testing.assert_allclose(predicted, np.array(states)[1:], rtol=0, atol=1e-8)
