"""Recordings of benchmark robots with an effect that their model lacks."""

import numpy as np
import pytest

from nfpde.benchmarks import collect, hide, robot
from nfpde.errors import BadEffect, BadInput
from nfpde.sim import MujocoSimulator

EFFECTS = {
    "coulomb_friction": ("leg_joint", {"torque": 2.0}),
    "actuation_delay": (None, {"delay": 0.012}),
    "motor_strength": ("thigh_joint", {"scale": 0.7}),
    "joint_offset_logged": ("leg_joint", {"offset": 0.05}),
    "gravity_tilt": (None, {"roll": 0.0, "pitch": 0.1}),
    "ground_friction": (None, {"sliding": 0.6}),
}
HOPPER = robot("hopper")


@pytest.mark.parametrize("name", EFFECTS)
def test_recordings_reproduce_with_the_effect_only(name):
    """As without effects: a control step from recorded states, at the true parameters, is the recorded one to 1e-10."""
    target, values = EFFECTS[name]
    hidden = hide(HOPPER.model, name, target, **values)
    dataset, truth = collect(HOPPER, "gaussian", episodes=3, steps=40, robots=1, effects=[hidden])
    assert truth.space.names[:6] == HOPPER.space.names
    assert truth.xi[:, 6:].tolist() == [list(values.values())] * 3
    simulator = MujocoSimulator(HOPPER.path, truth.space)
    dataset = simulator.prepare(dataset)
    windows = dataset.windows(1, history=simulator.history_steps(dataset.control_dt))
    np.testing.assert_allclose(simulator.predict(truth.xi[:1], windows)[0], windows.target, atol=1e-10)
    plain = MujocoSimulator(HOPPER.path, HOPPER.space).predict(truth.xi[:1, :6], windows)[0]
    assert np.abs(plain - windows.target).max() > 1e-3


def test_robots_take_episodes_in_turn():
    """Labels say which robot an episode is of, and the truth has its parameters; the population is of robots alike."""
    dataset, truth = collect(HOPPER, "mixture", episodes=5, steps=5, robots=2)
    assert [e.robot for e in dataset] == ["0", "1", "0", "1", "0"]
    assert len(np.unique(truth.xi, axis=0)) == 2
    np.testing.assert_array_equal(truth.xi[[0, 1, 0, 1, 0]], truth.xi)
    assert truth.population is not None
    hidden = hide(HOPPER.model, "coulomb_friction", "leg_joint", torque=2.0)
    assert collect(HOPPER, "mixture", episodes=2, steps=5, effects=[hidden])[1].population is None


def test_noise_is_on_what_is_recorded_only():
    """Of the size that was asked for, on every channel; the truth is that of the noisy recordings."""
    clean, noisy = (collect(robot("pendulum"), "gaussian", episodes=10, steps=100, noise=n) for n in (0.0, 0.02))
    for name in ("qpos", "qvel"):
        before, after = (np.concatenate([getattr(e, name) for e in data]) for data, _ in (clean, noisy))
        # 1000 rows tell a standard deviation to 2.2 %; four of those
        np.testing.assert_allclose((after - before).std(0), 0.02 * before.std(0), rtol=0.09)
    np.testing.assert_array_equal(clean[0][0].ctrl, noisy[0][0].ctrl)
    np.testing.assert_array_equal(clean[1].xi, noisy[1].xi)
    assert noisy[1].dataset == noisy[0].content_hash() != clean[1].dataset
    with pytest.raises(BadInput, match="noise must be a share of at least 0, got -1"):
        collect(robot("pendulum"), "gaussian", noise=-1.0)


def test_what_cannot_be_hidden():
    """An effect that does nothing, one that cannot act on the robot, and more robots than episodes."""
    with pytest.raises(BadEffect, match="motor_strength: with scale=1 it does nothing"):
        hide(HOPPER.model, "motor_strength", "thigh_joint", scale=1.0)
    with pytest.raises(BadEffect, match="actuator #0 is no position servo"):
        hide(HOPPER.model, "backlash_command", "thigh_joint", width=0.1)
    with pytest.raises(BadInput, match="3 robots need as many episodes at least, got 2"):
        collect(HOPPER, "gaussian", episodes=2, robots=3)
