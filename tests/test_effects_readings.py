"""Other readings of effects, where engineers mean different things by one name."""

import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.envs.mujoco import MujocoEnv

from nfpde import diagnose_gap
from nfpde.dataset import Dataset, Episode
from nfpde.effects import DataScales, effect, effect_names
from nfpde.effects.registry import _REGISTRY
from nfpde.errors import BadEffect
from nfpde.gap.accepted import simplest_first
from nfpde.gap.refit import among_readings
from nfpde.gap.trial import Trial
from nfpde.parameters import ParameterSpace
from nfpde.rl import RandomizedParameters
from nfpde.sim import MujocoSimulator
from tests.effect_checks import SERVO_ARM, make, neutral_does_nothing, predict, rows_are_apart, same_as
from tests.models import load, make_windows, plain_rollout, record, with_arrays

READINGS = [
    ("joint_offset_logged", "shoulder", {"offset": (-1, 1)}, [[0.1], [-0.4]]),
    ("sensor_scale_logged", "elbow", {"scale": (0.5, 2)}, [[0.8], [1.3]]),
    ("sensor_scale_position", "elbow", {"scale": (0.5, 2)}, [[0.8], [1.3]]),
    ("time_scale_counted", None, {"ratio": (0.5, 2)}, [[0.9], [1.1]]),
    ("backlash_command", "shoulder_servo", {"width": (0, 0.5)}, [[0.05], [0.3]]),
    ("motor_strength_command", "shoulder_servo", {"scale": (0, 2)}, [[0.7], [1.4]]),
    ("motor_strength_gear", "elbow_servo", {"scale": (0, 2)}, [[0.7], [1.4]]),
    ("dead_zone_gate", "wrist_motor", {"half_width": (0, 1)}, [[0.3], [0.6]]),
    ("dead_zone_gate", "shoulder_servo", {"half_width": (0, 1)}, [[0.1], [0.4]]),
    ("backlash_geared", "wrist_motor", {"width": (0, 0.5)}, [[0.02], [0.1]]),
    ("backlash_geared", "shoulder_servo", {"width": (0, 0.5)}, [[0.02], [0.1]]),
    ("backlash_outer", "shoulder_servo", {"width": (0, 0.5)}, [[0.02], [0.1]]),
    ("backlash_geared_outer", "elbow_servo", {"width": (0, 0.5)}, [[0.02], [0.1]]),
]


def test_all_are_here():
    """Each has the name of another effect, and its parameters."""
    readings = [name for name in effect_names() if _REGISTRY[name].says]
    assert readings == sorted({name for name, *_ in READINGS})
    for name in readings:
        plain = _REGISTRY[_REGISTRY[name].says]
        assert _REGISTRY[name].quantities == plain.quantities
        assert not plain.says


@pytest.mark.parametrize(("name", "target", "bounds", "values"), READINGS)
def test_neutral_and_rows(name, target, bounds, values):
    """Neutral rows are untouched by active ones beside them, and rows with other values do not mix."""
    sim = make(name, target, **bounds)
    neutral_does_nothing(sim, values)
    rows_are_apart(sim, values)


@pytest.mark.parametrize(("joint", "column"), [("shoulder", 0), ("elbow", 1)])
def test_what_is_wrong_in_the_log_alone_moves_no_servo(joint, column):
    """The true motion is that of the model; what is recorded of it is off, or a multiple."""
    offset = make("joint_offset_logged", joint, offset=(-1, 1))
    scale = make("sensor_scale_logged", joint, scale=(0.5, 2))
    windows = make_windows(offset.model, 3, 12, nsub=4)
    off, scaled = (windows.state.copy() for _ in range(2))
    off[..., column] += 0.3
    scaled[..., [column, 3 + column]] *= 1.2
    read = predict(offset, [[0.3]], with_arrays(windows, state=off))[0]
    multiple = predict(scale, [[1.2]], with_arrays(windows, state=scaled))[0]
    for n in range(3):
        expected = plain_rollout(offset.model, windows.start[n], windows.ctrl[n], 4)
        read[n, :, column] -= 0.3
        multiple[n][:, [column, 3 + column]] /= 1.2
        np.testing.assert_allclose(read[n], expected, rtol=0, atol=1e-11)
        np.testing.assert_allclose(multiple[n], expected, rtol=0, atol=1e-11)


def test_positions_alone_are_scaled_and_speeds_alone_are_counted():
    """The log's positions are a multiple, its speeds true; or the other way round, over steps of another length."""
    position, counted = (
        make("sensor_scale_position", "elbow", scale=(0.5, 2)),
        make("time_scale_counted", ratio=(0.5, 2)),
    )
    windows = make_windows(position.model, 3, 12, nsub=4)
    scaled, fast = (windows.state.copy() for _ in range(2))
    scaled[..., 1] *= 1.2
    fast[..., 3:] *= 1.1
    read = predict(position, [[1.2]], with_arrays(windows, state=scaled))[0]
    late = predict(counted, [[1.1]], with_arrays(windows, state=fast))[0]
    slow = load(SERVO_ARM)
    slow.opt.timestep *= 1.1
    for n in range(3):
        read[n, :, 1] /= 1.2
        late[n, :, 3:] /= 1.1
        start, ctrl = windows.start[n], windows.ctrl[n]
        np.testing.assert_allclose(read[n], plain_rollout(position.model, start, ctrl, 4), rtol=0, atol=1e-11)
        np.testing.assert_allclose(late[n], plain_rollout(slow, start, ctrl, 4), rtol=0, atol=1e-11)


def test_play_of_a_command():
    """By hand: the aim follows when the command has crossed the play, by the gear; nothing changes at its ends."""
    xml = SERVO_ARM.replace('joint="shoulder" kp="40"', 'joint="shoulder" gear="2" kp="40"')
    bound = effect("backlash_command", "shoulder_servo", width=(0, 1)).bind(load(xml))
    sent = np.array([0.0, 0.1, 0.3, 0.5, 0.45, 0.2, 0.1, 0.1, -0.4])
    ctrl = np.zeros((1, len(sent), 3))
    ctrl[0, :, 0] = sent
    aim = bound.command(ctrl, np.array([[0.2]]), 0.002)[0, :, 0]  # 0.4 of the command, 0.2 to either side
    np.testing.assert_allclose(aim, [0.0, 0.0, 0.1, 0.3, 0.3, 0.3, 0.3, 0.3, -0.2], atol=1e-15)
    with pytest.raises(BadEffect, match="actuator #2 is no position servo"):
        effect("backlash_command", "wrist_motor", width=(0, 1)).bind(load(xml))
    counted = load(SERVO_ARM)  # a servo whose command is in half radians
    counted.actuator_gainprm[0, 0] *= 0.5
    bound = effect("backlash_command", "shoulder_servo", width=(0, 1)).bind(counted)
    np.testing.assert_allclose(bound.command(ctrl, np.array([[0.2]]), 0.002)[0, :, 0], aim, atol=1e-15)


def test_what_readings_cannot_act_on_is_refused():
    """A motor has no feedback that stays; an environment keeps no commands of any age."""
    for name in ("motor_strength_command", "motor_strength_gear"):
        with pytest.raises(BadEffect, match="actuator #2 is no position or velocity servo"):
            make(name, "wrist_motor", scale=(0, 2))

    class Env(MujocoEnv):
        """An arm of servos."""

        def __init__(self, path):
            super().__init__(str(path), 4, gymnasium.spaces.Box(-9, 9, (6,)))

        def reset_model(self):
            return np.concatenate([self.data.qpos, self.data.qvel])

    play = effect("backlash_command", "shoulder_servo", width=(0, 0.3))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(SERVO_ARM)
        Env.metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"], "render_fps": 125}
        with pytest.raises(BadEffect, match="remembers commands of any age"):
            RandomizedParameters(Env(path), [[0.1]], ParameterSpace(play.parameters))


def test_play_goes_through_all_commands_that_are_known():
    """A command turned round three seconds ago and has crept since: where its aim is, no second of it tells."""
    play = effect("backlash_command", "shoulder_servo", width=(0, 0.3))
    sim = MujocoSimulator(load(SERVO_ARM), None, [play], nthread=1)
    dt, rows = 0.02, 200
    ctrl = np.zeros((rows, sim.model.nu))
    ctrl[:, 0] = np.interp(np.arange(rows) * dt, [0, 0.5, rows * dt], [0.0, 0.4, 0.36])
    still = np.zeros((rows, sim.model.nq))
    recorded = Dataset([Episode("0", np.arange(rows) * dt, still, still, ctrl)])
    known = round(3.5 / dt)
    long, short = (recorded.windows(2, stride=1, history=h, at=np.array([180])) for h in (known, sim.history_steps(dt)))
    half, aimed = 0.05, np.zeros_like(short.ctrl)
    aimed[:, :, 0] = 0.4 - half  # since the turn it has not moved, as the command has not crossed the play
    exact = sim.predict([[0.0]], with_arrays(short, ctrl=aimed))
    np.testing.assert_allclose(sim.predict([[2 * half]], long), exact, rtol=1e-12, atol=1e-12)
    assert np.abs(sim.predict([[2 * half]], short) - exact).max() > 1e-3


def test_places_are_for_names_and_of_equal_readings_the_plain_one_is_named():
    """Three readings of one name at most, which take no place of another's; ties go by the name's best, then plain."""
    bounds = {"backlash": {"width": (0, 1)}, "armature": {"inertia": (0, 1)}, "coulomb_friction": {"torque": (0, 1)}}
    names = ["backlash_geared", "backlash", "backlash_outer", "backlash_geared_outer", "armature", "coulomb_friction"]
    where = {"backlash": "shoulder_servo"}
    effects = [
        effect(n, where.get(_REGISTRY[n].says or n, "shoulder"), **bounds[_REGISTRY[n].says or n]) for n in names
    ]
    assert among_readings(effects, 1) == [0, 1, 2]
    assert among_readings(effects, 2) == [0, 1, 2, 4]
    assert among_readings(effects, 9) == [0, 1, 2, 4, 5]

    def trial(number, density):
        return cast(Trial, SimpleNamespace(effect=effects[number], density=np.full(5, density)))

    geared, plain, other = trial(0, 3.0), trial(1, 2.5), trial(4, 2.8)
    assert simplest_first([other, plain, geared]) == [plain, geared, other]


@pytest.mark.parametrize("servo", ["shoulder_servo", "elbow_servo"])
def test_strength_of_the_command_and_of_the_gear(servo):
    """Those of models with that gain, or with that gear, in the file."""
    for name, field in (("motor_strength_command", "actuator_gainprm"), ("motor_strength_gear", "actuator_gear")):
        model = load(SERVO_ARM)
        getattr(model, field)[model.actuator(servo).id] *= 0.7
        same_as(make(name, servo, scale=(0, 2)), [0.7], model)


def test_gates_of_a_motor_and_of_a_servo():
    """Nothing within, all beyond: of the command, and of the servo's error with its damping."""
    width = 0.35
    sim = make("dead_zone_gate", "wrist_motor", half_width=(0, 1))
    windows = make_windows(sim.model, 4, 12, nsub=4)
    gated = windows.ctrl.copy()
    gated[..., 2] *= np.abs(gated[..., 2]) > width
    assert 0 < np.count_nonzero(gated[..., 2]) < gated[..., 2].size
    predicted = predict(sim, [[width]], windows)[0]
    for n in range(4):
        expected = plain_rollout(sim.model, windows.start[n], gated[n], 4)
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-11)
    own, switched = load(SERVO_ARM), []

    def switch(model, data):
        on = abs(data.ctrl[0] - data.qpos[0]) > width
        switched.append(on)
        model.actuator_gainprm[0] = own.actuator_gainprm[0] * on
        model.actuator_biasprm[0] = own.actuator_biasprm[0] * on

    same_as(make("dead_zone_gate", "shoulder_servo", half_width=(0, 1)), [width], SERVO_ARM, switch)
    assert 0 < sum(switched) < len(switched)


PLAYING = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{timestep}" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="axle" axis="0 0 1" damping="0.3" frictionloss="{friction}" {armature}/>
      <inertial pos="0 0 0" mass="1" diaginertia="{first} {first} {first}"/>
      {second}
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""
WHEEL = """
<body><joint name="play" axis="0 0 1" limited="true" range="-0.02 0.02" solreflimit="0.0002 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.15 0.15 0.15"/></body>
"""
MOTOR, SERVO = '<motor name="drive" joint="axle"/>', '<position name="drive" joint="axle" kp="20" kv="0.7"/>'


@pytest.mark.parametrize(("friction", "most"), [(0.2, 0.25), (0.0, 0.05)])
@pytest.mark.parametrize(
    ("name", "actuator", "size"),
    [("backlash_geared", MOTOR, 1.0), ("backlash_geared", SERVO, 0.5), ("backlash_geared_outer", SERVO, 0.5)],
)
def test_a_rotor_that_resists_behind_its_play(name, actuator, size, friction, most):
    """The wheel moves as in a model of two bodies, damping and friction on the first, to a quarter of what play does.

    That is the rebound of its teeth, which ours have not: without friction, which makes them, it is a twentieth. A
    servo of the outer kind is a motor there, whose torque is that of the wheel's own position and speed.
    """
    outer = name == "backlash_geared_outer"
    one = {"first": 0.15, "second": "", "armature": 'armature="0.05"', "actuator": actuator}
    two = {"first": 0.05, "second": WHEEL, "armature": "", "actuator": MOTOR if outer else actuator}
    model, fine = (load(PLAYING.format(timestep=step, friction=friction, **one)) for step in (0.0005, 0.00005))
    both = load(PLAYING.format(timestep=0.00005, friction=friction, **two))
    time = 0.0005 * np.arange(1600)
    command = size * np.where(np.sin(2 * np.pi * time / 0.31) < 0, -1.0, 1.0)[:, None]
    windows = make_windows(model, 1, 1600)
    windows = with_arrays(windows, state=np.zeros_like(windows.state), ctrl=command[None])
    sim = MujocoSimulator(model, None, [effect(name, "drive", width=(0, 0.3))], check_influence=False)
    loose, tight = sim.predict([[0.04], [0.0]], windows)[:, 0, :, 0]
    sent = iter(command.repeat(10))

    def serve(model, data):
        aim = next(sent)
        if outer:
            data.ctrl[0] = 20 * (aim - data.qpos.sum()) - 0.7 * data.qvel.sum()

    states = plain_rollout(both, np.array([0.02, -0.02, 0.0, 0.0]), command, 10, serve)
    expected = states[:, 0] + states[:, 1] - plain_rollout(fine, np.zeros(2), command, 10)[:, 0]
    missed = np.std(loose - tight - expected)
    assert missed < most * np.std(expected)
    plain = MujocoSimulator(model, None, [effect("backlash", "drive", width=(0, 0.3))], check_influence=False)
    loose, tight = plain.predict([[0.04], [0.0]], windows)[:, 0, :, 0]
    assert np.std(loose - tight - expected) > 1.5 * missed  # the plain reading is another motion


def test_readings_are_tried_where_they_differ():
    """Of what a servo reads, where there is a servo; of what friction does in a play, everywhere."""
    model = load(SERVO_ARM)
    scales = DataScales.of(model, record(model, 2, 40, 4))
    tried = {name: [e.target for e in _REGISTRY[name].candidates(model, scales)] for name, *_ in READINGS}
    servos, drives = ["shoulder_servo", "elbow_servo"], ["shoulder_servo", "elbow_servo", "wrist_motor"]
    assert tried == {
        "joint_offset_logged": ["shoulder", "elbow"],
        "sensor_scale_logged": ["shoulder", "elbow"],
        "sensor_scale_position": ["shoulder", "elbow", "wrist"],
        "time_scale_counted": [None],
        "backlash_command": ["shoulder_servo"],
        "motor_strength_command": servos,
        "motor_strength_gear": servos,
        "dead_zone_gate": drives,
        "backlash_geared": drives,
        "backlash_outer": servos,
        "backlash_geared_outer": servos,
    }


SERVED = """
<mujoco><option timestep="0.005" integrator="implicitfast"/>
<worldbody>
  <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.02"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1.5"/>
    <body name="fore" pos="0 0 -.4"><joint name="elbow" axis="0 1 0" damping="0.2" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.35" size=".025" mass="1"/></body></body>
</worldbody>
<actuator><position name="lift" joint="shoulder" kp="60" kv="3"/>
<position name="bend" joint="elbow" kp="30" kv="1.5"/></actuator></mujoco>
"""


def served(change, log=lambda qpos, qvel: None):
    """Recordings of a changed arm of servos under sums of sines, as a log has them, with noise."""
    rng, out = np.random.default_rng(7), []
    for number in range(6):
        model = mujoco.MjModel.from_xml_string(SERVED)
        change(model)
        data, time = mujoco.MjData(model), 0.01 * np.arange(300)
        rate, phase = rng.uniform(0.3, 1.5, (2, 4)), rng.uniform(0, 2 * np.pi, (2, 4))
        ctrl = 0.25 * np.sin(2 * np.pi * rate[..., None] * time + phase[..., None]).sum(1).T
        qpos, qvel = np.empty((300, 2)), np.empty((300, 2))
        for row in range(300):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            mujoco.mj_step(model, data, 2)
        log(qpos, qvel)
        qpos += 3e-4 * rng.normal(size=qpos.shape)
        qvel += 1e-2 * rng.normal(size=qvel.shape)
        out.append(Episode(str(number), time, qpos, qvel, ctrl))
    return Dataset(out)


def offset(qpos, qvel):
    qpos[:, 1] += 0.07


def weaker(model):
    model.actuator_gainprm[1] *= 0.85


@pytest.mark.parametrize(
    ("data", "called", "target", "reading", "value"),
    [
        (served(lambda model: None, offset), "joint_offset", "elbow", "joint_offset_logged", 0.07),
        (served(weaker), "motor_strength", "bend", "motor_strength_command", 0.85),
    ],
    ids=["log", "command"],
)
def test_a_diagnosis_names_the_effect_and_says_how_it_is_meant(data, called, target, reading, value):
    """One effect is named, by the vocabulary's name, with the value of the reading that fits; no reading twice."""
    found = diagnose_gap(mujoco.MjModel.from_xml_string(SERVED), data)
    assert [(c.effect, c.target, c.reading) for c in found.effects] == [(called, target, reading)]
    (fitted,) = found.effects[0].parameters.values()
    assert fitted.value == pytest.approx(value, rel=0.02)
    assert (called, target) not in {(r.effect, r.target) for r in found.effects[0].indistinguishable}
    ranked = [(c.effect, c.target) for c in found.ranking]
    assert len(ranked) == len(set(ranked))
    assert found.to_json()["effects"][0]["reading"] == reading
