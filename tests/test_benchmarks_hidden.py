"""Recordings of benchmark robots with an effect that their model lacks."""

import numpy as np
import pytest

from nfpde.benchmarks import collect, hide, robot
from nfpde.errors import BadEffect, BadInput
from nfpde.sim import MujocoSimulator
from tests.command_line import run

EFFECTS = {
    "coulomb_friction": ("leg_joint", {"torque": 2.0}),
    "actuation_delay": ("*", {"delay": 0.012}),
    "time_scale": (None, {"ratio": 1.05}),
    "time_scale_counted": (None, {"ratio": 0.96}),
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


def test_elements_by_id_and_all_of_them():
    """The first joint is no "all"; a pendulum's only motor needs no name."""
    assert hide(HOPPER.model, "coulomb_friction", 0, torque=1.0).effect.ids.tolist() == [0]
    assert hide(HOPPER.model, "coulomb_friction", "*", torque=1.0).effect.ids.tolist() == list(range(6))
    assert hide(robot("pendulum").model, "actuation_delay", delay=0.1).effect.target == "motor"


def test_sensors_may_be_off_whatever_a_policy_sees():
    """Humanoid's observations hold forces, which no sensor effect describes; recordings hold positions and speeds."""
    body = robot("humanoid")
    hidden = hide(body.model, "joint_offset_logged", "right_knee", offset=0.1)
    off, plain = (collect(body, "gaussian", episodes=1, steps=3, effects=e)[0][0] for e in ([hidden], []))
    knee = body.model.joint("right_knee").qposadr[0]
    np.testing.assert_allclose(off.qpos[:, knee] - plain.qpos[:, knee], 0.1, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("actuation_delay delay=0.1 delay=0.2", "delay is given twice"),
        ("actuation_delay name=0.1", "give a value for each of delay; got name"),
        ("actuation_delay motor delay=late", "delay must be a number, got 'late'"),
        ("delay=0.1", "give its name, the element it acts on where it acts on one, and its values"),
        ("actuation_delay delay=0.1 motor", "give its name, the element"),
        ("actuation_delay 'motor delay=0.1", "No closing quotation"),
    ],
)
def test_what_a_command_line_cannot_mean(text, words):
    """Each is told with the text that was given."""
    status, out, err = run("collect", "pendulum", "--effect", text, "--out", "nowhere")
    assert (status, out) == (1, "")
    assert words in err


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
    with pytest.raises(BadEffect, match=r"needs the joint it acts on, or '\*' for all of them; there are: rootx"):
        hide(HOPPER.model, "coulomb_friction", torque=1.0)
    with pytest.raises(BadEffect, match="actuator #0 is no position servo"):
        hide(HOPPER.model, "backlash_command", "thigh_joint", width=0.1)
    with pytest.raises(BadInput, match="3 robots need as many episodes at least, got 2"):
        collect(HOPPER, "gaussian", episodes=2, robots=3)
