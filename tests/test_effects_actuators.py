"""Effects of actuators and of commands on their way to them, against plain MuJoCo and motor equations."""

import mujoco
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadEffect
from nfpde.sim import MujocoSimulator
from tests.effect_checks import (
    SERVO_ARM,
    make,
    neutral_does_nothing,
    predict,
    recording,
    replaced,
    rows_are_apart,
    same_as,
)
from tests.models import FLYWHEEL, load, make_windows, plain_rollout, with_arrays

SHOULDER = 'name="shoulder_servo" joint="shoulder" kp="40" kv="3"'
ELBOW = 'name="elbow_servo" joint="elbow" kv="1.5" gear="2"'
WRIST = 'name="wrist_motor" joint="wrist" gear="0.5"'
WHEEL = FLYWHEEL.format(integrator="Euler", frictionloss=0)
INERTIA = 0.2

ACTUATOR_EFFECTS = [
    ("motor_strength", "shoulder_servo", {"scale": (0, 2)}, [[0.7], [1.4]]),
    ("actuator_bias", "wrist_motor", {"offset": (-1, 1)}, [[0.3], [-0.2]]),
    ("actuator_lag", "*", {"time_constant": (0, 0.05)}, [[0.01], [0.05]]),
    ("actuation_delay", "*", {"delay": (0, 0.05)}, [[0.01], [0.033]]),
    ("observation_delay", None, {"delay": (0, 0.05)}, [[0.01], [0.033]]),
    ("torque_limit", "shoulder_servo", {"limit": (0.1, 20)}, [[0.5], [3.0]]),
    ("torque_speed", "wrist_motor", {"no_load_speed": (0.1, 9), "stall_torque": (0.1, 9)}, [[0.5, 0.2], [1.0, 0.4]]),
    ("dead_zone", "wrist_motor", {"half_width": (0, 1)}, [[0.1], [0.4]]),
    ("dead_zone", "shoulder_servo", {"half_width": (0, 1)}, [[0.1], [0.4]]),
    ("backlash", "wrist_motor", {"width": (0, 0.5)}, [[0.02], [0.1]]),
    ("backlash", "shoulder_servo", {"width": (0, 0.5)}, [[0.02], [0.1]]),
    ("servo_gain", "shoulder_servo", {"kp_scale": (0.1, 9), "kv_scale": (0.1, 9)}, [[0.5, 1], [1, 2], [2, 2]]),
    ("servo_gain", "elbow_servo", {"kp_scale": (0.1, 9), "kv_scale": (0.1, 9)}, [[1, 0.5], [1, 2]]),
    ("time_scale", None, {"ratio": (0.5, 2)}, [[0.9], [1.1]]),
]


@pytest.mark.parametrize(("name", "target", "bounds", "values"), ACTUATOR_EFFECTS)
def test_neutral_and_rows(name, target, bounds, values):
    """Neutral rows are untouched by active ones beside them, and rows with other values do not mix."""
    sim = make(name, target, **bounds)
    neutral_does_nothing(sim, values)
    rows_are_apart(sim, values)


def under(sim, values, torque, steps, speed=0.0):
    """Speed [rad/s] of the wheel after every millisecond under commands (steps,) or one for all."""
    windows = make_windows(sim.model, 1, steps, history=sim.history_steps(0.001))
    state, ctrl = np.zeros_like(windows.state), np.empty_like(windows.ctrl)
    state[:, 0, 1], ctrl[0, :, 0] = speed, torque
    history = np.full_like(windows.history, ctrl[0, 0, 0])
    return predict(sim, [values], with_arrays(windows, state=state, ctrl=ctrl, history=history))[0, 0, :, 1]


# Strength, bias, gains


def test_motor_strength_scales_a_motors_gear():
    """For a motor, torque = gear * command, so it is the same as another gear."""
    xml = replaced(WRIST, 'name="wrist_motor" joint="wrist" gear="0.35"')
    same_as(make("motor_strength", "wrist_motor", scale=(0, 2)), [0.7], xml)


def test_motor_strength_scales_both_gains_of_a_servo():
    """MJCF with both gains of the servo scaled."""
    xml = replaced(SHOULDER, 'name="shoulder_servo" joint="shoulder" kp="28" kv="2.1"')
    same_as(make("motor_strength", "shoulder_servo", scale=(0, 2)), [0.7], xml)


def test_actuator_bias_adds_to_the_command():
    """By hand, for a motor and for a servo."""
    for target, column in (("wrist_motor", 2), ("shoulder_servo", 0)):
        sim = make("actuator_bias", target, offset=(-1, 1))
        windows = make_windows(sim.model, 3, 10, nsub=4)
        shifted = windows.ctrl.copy()
        shifted[:, :, column] += 0.25
        predicted = predict(sim, [[0.25]], windows)[0]
        for n in range(3):
            np.testing.assert_array_equal(predicted[n], plain_rollout(sim.model, windows.start[n], shifted[n], 4))


def test_servo_gain_scales_the_gains_of_a_position_servo():
    """MJCF with other gains."""
    sim = make("servo_gain", "shoulder_servo", kp_scale=(0.1, 9), kv_scale=(0.1, 9))
    same_as(sim, [0.5, 2.0], replaced(SHOULDER, 'name="shoulder_servo" joint="shoulder" kp="20" kv="6"'))


def test_servo_gain_scales_the_gain_of_a_velocity_servo():
    """MJCF with another gain; a velocity servo has no kp."""
    sim = make("servo_gain", "elbow_servo", kp_scale=(0.1, 9), kv_scale=(0.1, 9))
    xml = replaced(ELBOW, 'name="elbow_servo" joint="elbow" kv="3" gear="2"')
    for kp in (1.0, 3.0):
        same_as(sim, [kp, 2.0], xml)


def test_servo_gain_needs_a_servo():
    """A motor has no gains of its own."""
    with pytest.raises(BadEffect, match="servo"):
        make("servo_gain", "wrist_motor", kp_scale=(0.1, 9), kv_scale=(0.1, 9))


# Limits


def test_torque_limit_is_behind_the_gear():
    """The limit at the joint is MuJoCo's forcerange times the gear."""
    xml = replaced(ELBOW, f'{ELBOW} forcerange="-0.4 0.4"')
    same_as(make("torque_limit", "elbow_servo", limit=(0.1, 9)), [0.8], xml)


def test_torque_limit_bounds_the_acceleration():
    """A wheel under a greater command gains limit / inertia per second, both ways round."""
    sim = make("torque_limit", 0, WHEEL, limit=(0.1, 9))
    for sign in (1, -1):
        speed = under(sim, [0.3], 1.0 * sign, 200)
        np.testing.assert_allclose(speed, sign * 0.3 / INERTIA * 0.001 * np.arange(1, 201), rtol=1e-9)


def test_torque_limit_tightens_only():
    """A limit of the model that is lower stays."""
    xml = replaced('joint name="elbow"', 'joint name="elbow" actuatorfrcrange="-0.3 0.6"')
    tighter = replaced('actuatorfrcrange="-0.3 0.6"', 'actuatorfrcrange="-0.3 0.5"', xml)
    same_as(make("torque_limit", "elbow_servo", xml, limit=(0.1, 9)), [0.5], tighter)


def test_torque_speed_runs_up_to_its_no_load_speed():
    """Under full command I v' = stall (1 - v / v0): v(t) = v0 (1 - exp(-t stall / (I v0))), both ways round."""
    sim = make("torque_speed", 0, WHEEL, no_load_speed=(0.1, 99), stall_torque=(0.1, 99))
    t = 0.001 * np.arange(1, 1001)
    for sign in (1, -1):
        speed = under(sim, [5.0, 2.0], 10.0 * sign, 1000)
        # steps of 1 ms against a time constant of 0.5 s
        np.testing.assert_allclose(speed, sign * 5 * (1 - np.exp(-t * 2 / (INERTIA * 5))), atol=5 * 2e-3)


def test_torque_speed_brakes_with_all_its_torque():
    """Against the motion the torque is the stall torque, however fast the wheel turns."""
    sim = make("torque_speed", 0, WHEEL, no_load_speed=(0.1, 99), stall_torque=(0.1, 99))
    speed = under(sim, [5.0, 2.0], -10.0, 300, speed=4.0)
    np.testing.assert_allclose(speed, 4.0 - 2.0 / INERTIA * 0.001 * np.arange(1, 301), rtol=1e-9)


def test_torque_speed_gives_nothing_beyond_its_no_load_speed():
    """A wheel that is faster keeps its speed."""
    sim = make("torque_speed", 0, WHEEL, no_load_speed=(0.1, 99), stall_torque=(0.1, 99))
    np.testing.assert_array_equal(under(sim, [5.0, 2.0], 1.0, 50, speed=6.0), 6.0)


# Dead zone and play


def test_dead_zone_of_a_motor_shrinks_the_command():
    """sign(u) max(|u| - w, 0), by hand."""
    sim = make("dead_zone", "wrist_motor", half_width=(0, 1))
    windows = make_windows(sim.model, 3, 10, nsub=4)
    less = windows.ctrl.copy()
    less[:, :, 2] = np.sign(less[:, :, 2]) * np.maximum(np.abs(less[:, :, 2]) - 0.3, 0)
    predicted = predict(sim, [[0.3]], windows)[0]
    for n in range(3):
        expected = plain_rollout(sim.model, windows.start[n], less[n], 4)
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-13)


def test_dead_zone_of_a_position_servo_is_on_its_error():
    """By hand: the command is moved towards the position by the half width."""
    sim = make("dead_zone", "shoulder_servo", half_width=(0, 1))
    windows = make_windows(sim.model, 3, 10, nsub=4)
    predicted = predict(sim, [[0.2]], windows)[0]
    for n in range(3):
        sent = windows.ctrl[n].repeat(4, axis=0)
        step = iter(sent)

        def shrink(model, data, step=step):
            error = next(step)[0] - data.qpos[0]
            data.ctrl[0] = data.qpos[0] + np.sign(error) * max(abs(error) - 0.2, 0.0)

        expected = plain_rollout(sim.model, windows.start[n], sent, 1, shrink)[3::4]
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-11)


GEARED = WHEEL.replace('<joint name="axle" axis="0 0 1"', '<joint name="axle" axis="0 0 1" armature="0.05"')
ROTOR = 0.05


def test_backlash_lets_the_wheel_coast_while_the_rotor_turns_round():
    """After a reversal the wheel keeps its speed until the rotor has crossed the play: width = torque t^2 / (2 J)."""
    sim = make("backlash", 0, GEARED, width=(0, 0.5))
    torque = np.r_[np.full(100, 1.0), np.full(300, -1.0)]
    for width in (0.01, 0.04, 0.09):
        speed = under(sim, [width], torque, 400)
        np.testing.assert_allclose(speed[:100], np.arange(1, 101) * 0.001 / (INERTIA + ROTOR), rtol=1e-9)
        crossing = np.sqrt(2 * width * ROTOR)  # 32, 63 and 95 ms
        after = 0.001 * np.arange(1, 301)
        coasting = speed[100:][after < crossing - 0.004]
        assert len(coasting) > 20
        np.testing.assert_allclose(coasting, speed[99], atol=0.02 * speed[99])
        meeting = after > crossing + 0.004
        # all torque since the start has gone into both, which turn together: nothing of the momentum is lost
        momentum = (0.1 - after[meeting]) / (INERTIA + ROTOR)
        np.testing.assert_allclose(speed[100:][meeting], momentum, atol=0.012)


def test_backlash_shows_a_servo_its_rotor():
    """Held against gravity, a servo stands off by half the play more than without, on the side that it pushes to."""
    xml = """<mujoco><option timestep="0.001"/><worldbody><body><joint name="hinge" axis="0 1 0" armature="0.05"
      damping="0.5"/><geom type="sphere" size="0.03" pos="0.3 0 0" mass="0.5"/></body></worldbody>
      <actuator><position name="servo" joint="hinge" kp="60" kv="4"/></actuator></mujoco>"""
    sim = make("backlash", "servo", xml, width=(0, 0.5))
    windows = make_windows(sim.model, 1, 3000)
    windows = with_arrays(windows, state=np.zeros_like(windows.state), ctrl=np.zeros_like(windows.ctrl))
    stiff, loose = predict(sim, [[0.0], [0.06]], windows)[:, 0, -1, 0]
    # the weight turns the hinge to positive angles, the servo pushes back: the joint hangs 0.03 further
    gravity, stiffness = 0.5 * 9.81 * 0.3, 60
    assert stiff == pytest.approx(gravity * np.cos(stiff) / stiffness, abs=1e-4)
    assert loose - 0.03 == pytest.approx(gravity * np.cos(loose) / stiffness, abs=1e-3)


def test_backlash_is_recovered():
    """From the motion of wheel and rotor, each integrated for itself in small steps, which meet without rebound.

    No recording holds the rotor: where it is at a window's start, the rows before tell.
    """
    rng = np.random.default_rng(0)
    ctrl = rng.uniform(-1, 1, 40).repeat(20)[:, None]
    dt, fine, width = 0.005, 100, 0.006
    wheel, rotor, w, v = 0.0, 0.5 * width * np.sign(ctrl[0, 0]), 0.0, 0.0
    rows, between = [], []
    for torque in ctrl[:, 0]:
        rows.append([wheel, w])
        between.append(abs(rotor - wheel) < 0.4 * width)
        for _ in range(fine):
            v += torque / ROTOR * dt / fine
            apart = rotor - wheel
            if abs(apart) >= width / 2 and apart * (v - w) > 0:
                w = v = (INERTIA * w + ROTOR * v) / (INERTIA + ROTOR)
            wheel, rotor = wheel + w * dt / fine, rotor + v * dt / fine
    sim = make("backlash", 0, GEARED, width=(0, 0.2))
    windows = recording(np.array(rows), ctrl, sim.model, dt).windows(
        40, stride=3, history=sim.history_steps(dt), past=sim.past_steps(dt)
    )
    assert np.array(between)[windows.row].sum() > 5
    grid = np.linspace(0, 0.018, 31)
    losses = sim.losses(grid[:, None], windows, np.ones(2)).sum(1)
    # physics steps of 1 ms against crossings of 30 ms, which take the root of the width: two steps are 13 %
    assert abs(grid[losses.argmin()] - width) <= 0.13 * width
    assert losses.min() < 0.05 * losses[0]
    # windows that start while the rotor crosses the play: without the rows before, nobody knows
    crossing = windows[np.flatnonzero(np.array(between)[windows.row])]
    blind = with_arrays(crossing, past=crossing.past[:, :0])
    known, unknown = (sim.losses([[width]], w, np.ones(2)).sum() for w in (crossing, blind))
    assert known < 0.2 * unknown


# Time


def test_actuator_lag_is_mujocos_filter():
    """A step of the command through MuJoCo's own first-order filter, within half a physics step."""
    sim = make("actuator_lag", 0, WHEEL, time_constant=(0, 0.1))
    torque = np.r_[np.zeros(100), np.ones(400)]
    speed = under(sim, [0.08], torque, 500)
    filtered = load(WHEEL.replace('<motor joint="axle"/>', '<general joint="axle" dyntype="filter" dynprm="0.08"/>'))
    data = mujoco.MjData(filtered)
    expected = []
    for u in torque:
        data.ctrl[0] = u
        mujoco.mj_step(filtered, data)
        expected.append(data.qvel[0])
    np.testing.assert_allclose(speed, expected, atol=1.1 * 0.001 / INERTIA)


def test_actuator_lag_answers_a_step_exponentially():
    """Torque 1 - exp(-t / T) gives the speed (t - T (1 - exp(-t / T))) / I, exactly: commands hold within a step."""
    sim = make("actuator_lag", 0, WHEEL, time_constant=(0, 0.1))
    for constant in (1e-5, 0.002, 0.08):
        speed = under(sim, [constant], np.r_[np.zeros(100), np.ones(400)], 500)[100:]
        t = 0.001 * np.arange(1, 401)
        np.testing.assert_allclose(speed, (t + constant * np.expm1(-t / constant)) / INERTIA, rtol=0, atol=1e-12)


def test_actuator_lag_remembers_commands_from_before_the_window():
    """Cut into windows, a lagged recording is predicted as well in each as from its beginning."""
    sim = make("actuator_lag", 0, WHEEL, time_constant=(0, 0.02))
    rng = np.random.default_rng(0)
    torque = rng.uniform(-1, 1, 300)
    speed = under(sim, [0.02], torque, 300)
    states = np.stack([np.cumsum(np.r_[0, speed[:-1]]) * 0.001, np.r_[0, speed[:-1]]], axis=1)
    late = recording(states, torque[:, None], sim.model, 0.001).windows(5, history=sim.history_steps(0.001))
    late = late[np.flatnonzero(late.row >= late.history.shape[1])]
    predicted = sim.predict([[0.02]], late)[0]
    # what the filter has forgotten: exp(-5) of a command, over five steps
    assert len(late) > 20
    assert np.abs(predicted - late.target)[..., 1].max() < np.exp(-5) * 2 * 0.005 / INERTIA


@pytest.mark.parametrize("delay", [0.002, 0.006, 0.008, 0.022])
def test_observation_delay_explains_late_records(delay):
    """Rows hold the state of `delay` earlier: at that delay the replay reproduces them, from any row on."""
    model, nsub = load(SERVO_ARM), 4
    rng = np.random.default_rng(1)
    ctrl = rng.uniform(-1, 1, (60, 3))
    fine = plain_rollout(model, np.zeros(6), ctrl.repeat(nsub, axis=0), 1)
    fine = np.vstack([np.zeros((1, 6)), fine])
    late = round(delay / 0.002)
    rows = np.arange(20, 60)
    dataset = recording(fine[nsub * rows - late], ctrl[rows], model, 0.008)
    sim = make("observation_delay", delay=(0, 0.03))
    windows = dataset.windows(8, history=sim.history_steps(0.008))
    windows = windows[np.flatnonzero(windows.row >= windows.history.shape[1])]
    predicted = sim.predict([[delay], [0.0]], windows)
    np.testing.assert_allclose(predicted[0], windows.target, rtol=0, atol=1e-10)
    assert np.abs(predicted[1] - windows.target).max() > 1e-3


def test_observation_delay_is_actuation_delay_of_all():
    """What no open-loop recording can tell apart is predicted alike."""
    one, other = make("observation_delay", delay=(0, 0.05)), make("actuation_delay", "*", delay=(0, 0.05))
    windows = make_windows(one.model, 3, 10, nsub=4, history=one.history_steps(0.008))
    np.testing.assert_array_equal(predict(one, [[0.013]], windows), predict(other, [[0.013]], windows))


@pytest.mark.parametrize("ratio", [0.9, 1.04])
def test_time_scale_is_another_timestep(ratio):
    """A robot whose control steps last longer than the recording says; speeds in true seconds."""
    model = load(SERVO_ARM)
    model.opt.timestep *= ratio
    rng = np.random.default_rng(2)
    ctrl = rng.uniform(-1, 1, (40, 3))
    states = np.vstack([np.zeros((1, 6)), plain_rollout(model, np.zeros(6), ctrl[:-1], 4)])
    windows = recording(states, ctrl, model, 0.008).windows(10)
    sim = make("time_scale", ratio=(0.5, 2))
    np.testing.assert_allclose(sim.predict([[ratio]], windows)[0], windows.target, rtol=0, atol=1e-11)
    # free fall, and all else with a rate of its own, tells it from any other value
    assert np.abs(sim.predict([[1.0]], windows)[0] - windows.target).max() > 1e-3


def test_a_whole_drive_composes():
    """Delay, bias, dead zone and weakness of one motor: the command by hand, then plain MuJoCo with another gear."""
    chosen = [
        effect("actuation_delay", "wrist_motor", delay=(0, 0.05)),
        effect("actuator_bias", "wrist_motor", offset=(-1, 1)),
        effect("dead_zone", "wrist_motor", half_width=(0, 1)),
        effect("motor_strength", "wrist_motor", scale=(0, 2)),
    ]
    sim = MujocoSimulator(load(SERVO_ARM), None, chosen)
    windows = make_windows(sim.model, 3, 10, nsub=4, history=sim.history_steps(0.008))
    predicted = predict(sim, [[0.006, 0.1, 0.2, 0.8]], windows)[0]
    weak = load(replaced(WRIST, 'name="wrist_motor" joint="wrist" gear="0.4"'))
    for n in range(3):
        sent = np.concatenate([windows.history[n], windows.ctrl[n]]).repeat(4, axis=0)
        first = 4 * windows.history.shape[1]
        u = sent[first - 3 : len(sent) - 3, 2] + 0.1  # 6 ms are three physics steps
        commands = sent[first:].copy()
        commands[:, 2] = np.sign(u) * np.maximum(np.abs(u) - 0.2, 0)
        expected = plain_rollout(weak, windows.start[n], commands, 1)[3::4]
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-11)
