"""Effects of drives on motors and servos: against loops written out by hand, and recovered."""

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nfpde.effects import DataScales, effect
from nfpde.effects.registry import _REGISTRY
from nfpde.errors import BadEffect
from nfpde.sim import MujocoSimulator
from tests.models import DOUBLE_PENDULUM, FLYWHEEL, load, make_windows, plain_rollout, record, with_arrays

MOTORS = '<motor joint="shoulder" gear="3"/>\n    <motor name="elbow_motor" joint="elbow"/>'
SERVOS = (
    '<position joint="shoulder" kp="30" kv="2" gear="3"/>'
    '<position name="elbow_motor" joint="elbow" kp="8" kv="0.3" ctrlrange="-0.8 0.8" forcerange="-3 3"/>'
)
SPEEDS = '<velocity joint="shoulder" kv="3"/><velocity name="elbow_motor" joint="elbow" kv="0.5"/>'
PLANTS = {"motors": MOTORS, "servos": SERVOS, "speeds": SPEEDS}

NEVER = 1e12
FREE_LINE = {"no_load_speed": (0.1, NEVER), "stall_torque": (0.01, NEVER)}
LAG = ("actuator_lag", {"time_constant": (0, 0.02)}, [[0.013], [0.0], [0.002]], [0.0])
LINE = ("torque_speed", FREE_LINE, [[2.0, 0.3], [0.5, 3.0], [NEVER, 0.2]], [NEVER, NEVER])
ZONE = ("dead_zone", {"half_width": (0, 1)}, [[0.2], [0.0], [0.5]], [0.0])
PLAY = ("backlash", {"width": (0, 0.3)}, [[0.02], [0.0], [0.1]], [0.0])
GAIN = ("servo_gain", {"kp_scale": (0.2, 5), "kv_scale": (0.2, 5)}, [[1.5, 0.5], [1.0, 1.0], [0.7, 2.0]], [1.0, 1.0])
LOAD = ("load_friction", {"base": (0, 1), "share": (0, 1)}, [[0.1, 0.3], [0.0, 0.0], [0.0, 0.6]], [0.0, 0.0])
OWN = [c[0] for c in (LAG, LINE, ZONE, PLAY, GAIN, LOAD)]
CASES = [(plant, *c) for plant in PLANTS for c in (LAG, LINE, ZONE, PLAY, GAIN, LOAD) if (plant, c) != ("motors", GAIN)]


def plant(name):
    return load(DOUBLE_PENDULUM.replace(MOTORS, PLANTS[name]))


def simulator(model, name, bounds, target=None):
    target = target or ("elbow" if name == "load_friction" else "elbow_motor")
    return MujocoSimulator(model, None, [effect(name, target, **bounds)], check_influence=False)


@pytest.mark.parametrize(("where", "name", "bounds", "rows", "neutral"), CASES)
def test_neutral_and_rows(where, name, bounds, rows, neutral):
    """Neutral values give the bits of the model alone, and rows of a batch those of one by one."""
    sim = simulator(plant(where), name, bounds)
    windows = make_windows(sim.model, 3, 8, nsub=3, history=20)
    rows = [*rows, neutral]
    together = sim.predict(rows, windows)
    for row, values in zip(together, rows, strict=True):
        np.testing.assert_array_equal(sim.predict([values], windows)[0], row)
    for n in range(3):
        alone = plain_rollout(sim.model, windows.start[n], windows.ctrl[n], 3)
        np.testing.assert_array_equal(together[-1, n], alone)
    assert np.abs(together[0] - together[-1]).max() > 1e-5


# Lag


def test_a_lag_is_the_filter_solved_exactly():
    """The mean over every physics step of the solution of tau y' = u - y, by an integrator of high order."""
    tau, dt = 0.013, 0.002
    commands = np.random.default_rng(0).uniform(-1, 1, (1, 12, 2))
    lag = effect("actuator_lag", "elbow_motor", time_constant=(0, 0.1)).bind(plant("motors"))
    out = lag.command(commands, np.array([[tau]]), dt)
    np.testing.assert_array_equal(out[..., 0], commands[..., 0])
    y = commands[0, 0, 1]
    for s, u in enumerate(commands[0, :, 1]):
        solved = solve_ivp(lambda t, z, u=u: [(u - z[0]) / tau, z[0]], (0, dt), [y, 0.0], rtol=1e-11, atol=1e-13)
        assert out[0, s, 1] == pytest.approx(solved.y[1, -1] / dt, abs=1e-9)
        y = solved.y[0, -1]


def test_a_short_lag_tends_to_none():
    """A millionth of a time step: the commands to as many digits, for all actuators with '*'."""
    lag = effect("actuator_lag", "*", time_constant=(0, 0.1)).bind(plant("motors"))
    commands = np.random.default_rng(0).uniform(-1, 1, (1, 12, 2))
    out = lag.command(commands, np.array([[2e-9]]), 0.002)
    np.testing.assert_allclose(out, commands, atol=4e-6)
    assert lag.memory_time() == pytest.approx(0.5)


# Torque-speed line


@pytest.mark.parametrize("where", PLANTS)
def test_a_line_limits_the_torque_at_the_joint(where):
    """The loop by hand: MuJoCo's own actuator torque at every step, clipped to the line, comes as an applied force."""
    model = plant(where)
    sim = simulator(model, *LINE[:2], target="shoulder")
    windows = make_windows(model, 3, 8, nsub=3, speed=3.0)
    top, stall = 4.0, 2.5
    predicted = sim.predict([[top, stall]], windows)[0]
    limited = 0

    def drive(model, data):
        nonlocal limited
        data.qfrc_applied[0] = 0
        mujoco.mj_forward(model, data)
        torque, speed = data.qfrc_actuator[0], data.qvel[0]
        most = stall if torque * speed <= 0 else stall * max(0.0, 1 - abs(speed) / top)
        limited += abs(torque) > most
        data.qfrc_applied[0] = np.clip(torque, -most, most) - torque

    for n in range(3):
        expected = plain_rollout(sim.model, windows.start[n], windows.ctrl[n], 3, drive)
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-9)
    assert limited > 10


def test_a_wheel_follows_the_line_to_its_no_load_speed():
    """Full throttle on a bare wheel: v = top (1 - exp(-t stall / (I top)))."""
    model = load(FLYWHEEL.format(integrator="Euler", frictionloss=0))
    sim = simulator(model, *LINE[:2], target="axle")
    windows = make_windows(model, 1, 2000)
    windows = with_arrays(windows, state=np.zeros_like(windows.state), ctrl=np.full_like(windows.ctrl, 50.0))
    speed = sim.predict([[3.0, 0.8]], windows)[0, 0, :, 1]
    time = 0.001 * np.arange(1, 2001)
    # Euler: the relative step stall dt / (I top) is 0.0013
    np.testing.assert_allclose(speed, 3 * (1 - np.exp(-time * 0.8 / (0.2 * 3))), rtol=0, atol=3 * 0.0013)


# Dead zone


@pytest.mark.parametrize("where", PLANTS)
def test_a_dead_zone_by_hand(where):
    """Commands of motors, errors of position servos: the middle is gone, the rest comes nearer to zero by as much."""
    sim = simulator(plant(where), *ZONE[:2])
    windows = make_windows(sim.model, 3, 8, nsub=3)
    predicted = sim.predict([[0.3]], windows)[0]
    # the loop sends commands beyond the range, when the joint is there
    free = load(DOUBLE_PENDULUM.replace(MOTORS, PLANTS[where].replace('ctrlrange="-0.8 0.8"', "")))

    def shrunk(x):
        return np.sign(x) * max(0.0, abs(x) - 0.3)

    for n in range(3):
        sent = iter(windows.ctrl[n, :, 1].repeat(3))

        def send(model, data, sent=sent):
            command = next(sent)
            if where == "servos":
                data.ctrl[1] = data.qpos[1] + shrunk(np.clip(command, -0.8, 0.8) - data.qpos[1])
            else:
                data.ctrl[1] = shrunk(command)

        expected = plain_rollout(free, windows.start[n], windows.ctrl[n].repeat(3, axis=0), 1, send)
        np.testing.assert_allclose(predicted[n], expected[2::3], rtol=0, atol=1e-10)


# Friction under load


@pytest.mark.parametrize("where", PLANTS)
def test_friction_grows_with_the_torque_that_mujoco_gives(where):
    """A loop that asks MuJoCo for its actuator torque and writes frictionloss before every step."""
    sim = simulator(plant(where), *LOAD[:2])
    windows = make_windows(sim.model, 3, 8, nsub=3)
    predicted = sim.predict([[0.05, 0.4]], windows)[0]

    def rub(model, data):
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        model.dof_frictionloss[1] = 0.05 + 0.4 * abs(data.qfrc_actuator[1])

    for n in range(3):
        expected = plain_rollout(plant(where), windows.start[n], windows.ctrl[n], 3, rub)
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-9)


# Backlash

WHEEL = """
<mujoco>
  <option timestep="0.0005" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="axle" axis="0 0 1" armature="0.05"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.15 0.15 0.15"/>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""
"""A wheel of 0.15 kg m2 behind a rotor of 0.05 kg m2."""

TWO_BODIES = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.00005" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="axle" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/>
      <body>
        <joint name="play" axis="0 0 1" limited="true" range="-0.02 0.02" solreflimit="0.0002 1"/>
        <inertial pos="0 0 0" mass="1" diaginertia="0.15 0.15 0.15"/>
      </body>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""
"""The same with the rotor as a body of its own, and the play as a stiff limit; a tenth of the time step."""


@pytest.mark.parametrize(
    ("actuator", "size"),
    [('<motor joint="axle"/>', 1.0), ('<position joint="axle" kp="20" kv="0.7"/>', 0.5)],
    ids=["motor", "servo"],
)
def test_backlash_is_a_rotor_with_play(actuator, size):
    """The wheel moves as in a model of two bodies with a stiff limit between them, to a tenth of what play does."""
    model, two = load(WHEEL.format(actuator=actuator)), load(TWO_BODIES.format(actuator=actuator))
    fine = load(WHEEL.format(actuator=actuator).replace("0.0005", "0.00005"))
    time = 0.0005 * np.arange(1600)
    command = size * np.where(np.sin(2 * np.pi * time / 0.31) < 0, -1.0, 1.0)[:, None]
    windows = make_windows(model, 1, 1600)
    windows = with_arrays(windows, state=np.zeros_like(windows.state), ctrl=command[None])
    loose, tight = simulator(model, *PLAY[:2], target="axle").predict([[0.04], [0.0]], windows)[:, 0, :, 0]
    # the rotor starts where its torque pushes, 0.02 ahead of the wheel
    states = plain_rollout(two, np.array([0.02, -0.02, 0.0, 0.0]), command, 10)
    expected = states[:, 0] + states[:, 1] - plain_rollout(fine, np.zeros(2), command, 10)[:, 0]
    # the differences, in which most of Euler's own error of ten times longer steps goes away
    assert np.std(loose - tight - expected) < 0.1 * np.std(expected)


def test_backlash_keeps_momentum():
    """Whatever the play, a motor's impulse is in wheel and rotor together once they turn together again."""
    model = load(WHEEL.format(actuator='<motor joint="axle"/>'))
    windows = make_windows(model, 1, 400)
    ctrl = np.ones((1, 400, 1))
    ctrl[:, 100:] = -1.0
    windows = with_arrays(windows, state=np.zeros_like(windows.state), ctrl=ctrl)
    speed = simulator(model, *PLAY[:2], target="axle").predict([[0.001], [0.003], [0.0]], windows)[:, 0, :, 1]
    np.testing.assert_allclose(speed[:, -1], 0.0005 * (100 - 300) / 0.2, rtol=0, atol=1e-9)


@pytest.mark.parametrize("where", PLANTS)
def test_a_rotor_is_moved_by_the_time_step_of_its_joint(where):
    """Beside `time_scale` each row is that of a model compiled with the row's own time step, bit for bit."""
    effects = [effect("backlash", "elbow_motor", width=(0, 0.3)), effect("time_scale", ratio=(0.8, 1.25))]
    sim = MujocoSimulator(plant(where), None, effects, check_influence=False)
    windows = make_windows(sim.model, 3, 12, nsub=4)
    predicted = sim.predict([[0.1, 1.25], [0.1, 0.8]], windows)
    for ratio, rows in zip((1.25, 0.8), predicted, strict=True):
        other = plant(where)
        other.opt.timestep *= ratio
        slower = with_arrays(windows, control_dt=ratio * windows.control_dt)
        np.testing.assert_array_equal(simulator(other, *PLAY[:2]).predict([[0.1]], slower)[0], rows)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_backlash_is_stable_with_stiff_servos(integrator):
    """A servo that MuJoCo can hold the wheel with, but that is too stiff for the bare rotor: kv dt / J > 2."""
    model = load(
        WHEEL.format(actuator='<position joint="axle" kp="2000" kv="25"/>').replace(
            'timestep="0.0005"', f'timestep="0.005" integrator="{integrator}"'
        )
    )
    windows = make_windows(model, 4, 200, spread=0.05)
    windows = with_arrays(windows, ctrl=0.1 * windows.ctrl)
    predicted = simulator(model, *PLAY[:2], target="axle").predict([[0.05]], windows)[0]
    assert np.abs(predicted[..., 0]).max() < 1.0


# Recovery, and where the effects make no sense

RECOVERED = [
    ("motors", "actuator_lag", {"time_constant": (0, 0.05)}, [0.012], 0.001),
    ("motors", "torque_speed", {"no_load_speed": (0.5, 20), "stall_torque": (0.1, 10)}, [6.0, 1.0], 0.1),
    ("motors", "dead_zone", {"half_width": (0, 2)}, [0.4], 0.02),
    ("motors", "backlash", {"width": (0, 0.3)}, [0.06], 0.004),
    ("servos", "servo_gain", {"kp_scale": (0.2, 5), "kv_scale": (0.2, 5)}, [1.6, 0.7], 0.05),
    ("motors", "load_friction", {"base": (0, 1), "share": (0, 0.9)}, [0.1, 0.35], 0.01),
]


@pytest.mark.parametrize(("where", "name", "bounds", "true", "step"), RECOVERED)
def test_recovered_from_recordings(where, name, bounds, true, step):
    """Of 11 values around the truth, of each parameter, the recorded one has the least loss, and no loss at all."""
    model = plant(where)
    sim = simulator(model, name, bounds)
    blank = record(model, 3, 24, 5, amplitude=2.0).windows(12, history=sim.history_steps(0.01))
    truth = sim.predict([true], blank)[0]
    windows = with_arrays(blank, state=np.concatenate([blank.state[:, :1], truth], axis=1))
    for i in range(len(true)):
        values = np.array(true)[None].repeat(11, axis=0)
        values[:, i] += step * np.arange(-5, 6)
        losses = sim.losses(values, windows, np.ones(4)).sum(1)
        assert losses.argmin() == 5
        assert losses[5] < 1e-20 < 1e-9 < np.delete(losses, 5).min()


TENDON = """
<mujoco>
  <worldbody><body><joint name="a"/><geom size="0.1"/></body></worldbody>
  <tendon><fixed name="t"><joint joint="a" coef="1"/></fixed></tendon>
  <actuator><motor name="pull" tendon="t"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("name", "bounds", "text"),
    [
        (*LINE[:2], "torque_speed on 'pull': it needs actuators that act on a hinge or a slide"),
        (*ZONE[:2], "dead_zone on 'pull': actuator #0 is no motor, position servo or velocity servo"),
        (*PLAY[:2], "backlash on 'pull': actuator #0 is no motor, position servo or velocity servo"),
        (*GAIN[:2], "servo_gain on 'pull': it needs position or velocity servos"),
        (*LOAD[:2], "load_friction on 'a': no motor or servo drives joint #0"),
    ],
)
def test_drives_that_cannot_have_it(name, bounds, text):
    """A motor behind a tendon has no joint of its own."""
    with pytest.raises(BadEffect, match=text):
        simulator(load(TENDON), name, bounds, target="a" if name == "load_friction" else "pull")


@pytest.mark.parametrize("where", PLANTS)
def test_where_a_diagnosis_tries_them(where):
    """On every drive of the right kind, at values inside their bounds; delays and lags on all drives at once too."""
    model = plant(where)
    scales = DataScales.of(model, record(model, 2, 40, 5))
    found = {name: _REGISTRY[name].candidates(model, scales) for name in sorted(_REGISTRY)}
    drives = ["shoulder", "elbow_motor"]
    for name in ("torque_speed", "dead_zone", "backlash"):
        assert [e.target for e in found[name]] == drives
    assert [e.target for e in found["servo_gain"]] == (drives if where != "motors" else [])
    assert [e.target for e in found["load_friction"]] == ["shoulder", "elbow"]
    assert [e.target for e in found["actuator_lag"]] == [*drives, "*"]
    for name in ("time_scale", "observation_delay"):
        assert [e.place for e in found[name]] == ["all"]
    for e in (e for name in ("joint_offset", "sensor_scale", *OWN) for e in found[name]):
        low, high = np.array([(p.low, p.high) for p in e.parameters]).T
        values = e.screened(scales)
        assert values.shape[1] == len(low)
        assert (values > low).all()
        assert (values < high).all()


def test_no_diagnosis_of_drives_behind_tendons():
    """They have no joint whose torque or play could be meant."""
    model = load(TENDON)
    scales = DataScales.of(model, record(model, 1, 20, 5))
    for name in ("torque_speed", "dead_zone", "backlash", "servo_gain", "load_friction"):
        assert _REGISTRY[name].candidates(model, scales) == []
