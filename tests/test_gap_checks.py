"""Recordings that do not fit the model are refused by name, and what a verdict makes of an uncertain floor."""

from contextlib import nullcontext
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.errors import BadDataset, BadInput, SimulationDiverged
from nfpde.gap import checks, diagnose_gap, mistakes
from nfpde.gap.answer import _verdict
from nfpde.gap.checks import check_fit, check_readings
from nfpde.gap.foresight import check_commands
from nfpde.gap.levels import NEAR_FLOOR
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.report import Level
from tests.gap_systems import ARM, nominal, record


def test_a_robot_that_moves_seldom_is_not_said_to_rest():
    """Between two looks: cut the rest away, rather than record anew."""
    time, rest, moved = 0.01 * np.arange(4000), np.zeros((4000, 2)), np.zeros((4000, 2))
    moved[3990:3992] = 0.1
    for motion, words in (
        (moved, "nothing moves in nearly all of these recordings: cut away where the robot rests"),
        (rest, "nothing moves in these recordings, so no gap"),
    ):
        data = Dataset([Episode(str(i), time, motion, 2.0 * motion, rest) for i in range(2)])
        with pytest.raises(BadDataset, match=words):
            check_fit(Replay(nominal(), None, []), data, cut_recordings(data, 3, 0, 40), np.zeros(0))


def test_robots_are_diagnosed_one_by_one():
    """What two robots differ by is no effect; each alone is what it is."""
    data = record()
    two = Dataset([replace(e, robot="left" if i % 2 else "right") for i, e in enumerate(data)])
    with pytest.raises(BadDataset, match=r"2 robots \(right and left\), and a diagnosis is of one: choose one"):
        diagnose_gap(nominal(), two)
    with pytest.raises(BadInput, match=r"no robot 'both' in these recordings of right and left"):
        diagnose_gap(nominal(), two, robot="both")
    with pytest.raises(BadInput, match=r"no robot 'left' in these recordings that name no robot"):
        diagnose_gap(nominal(), data, robot="left")
    found = diagnose_gap(nominal(), two, robot="left", windows=40)
    assert found.verdict == "no_gap"
    assert set(found.held_out_episodes) < {e.name for i, e in enumerate(data) if i % 2}


ODD = np.array([1.0, -1.0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda q, v, u: (q * ODD, v * ODD, u * ODD), "elbow's sign looks flipped \\("),
        (lambda q, v, u: (q * ODD, v * ODD, u), "elbow's sign looks flipped in qpos and qvel"),
        (lambda q, v, u: (q, v, u * ODD), "elbow's sign looks flipped in the commands"),
        (lambda q, v, u: (q[:, ::-1], v[:, ::-1], u[:, ::-1]), "shoulder and elbow look swapped \\("),
        (lambda q, v, u: (q[:, ::-1], v[:, ::-1], u), "shoulder and elbow look swapped in qpos and qvel"),
        (lambda q, v, u: (q, v, u[:, ::-1]), "shoulder and elbow look swapped in the commands"),
    ],
)
def test_signs_and_columns_are_named(change, words):
    """States, commands or both of a joint with the wrong sign or in the wrong column: the text says which."""
    wrong = [Episode(e.name, e.time, *change(e.qpos, e.qvel, e.ctrl)) for e in record(noise=1e-3)]
    with pytest.raises(BadDataset, match=words):
        diagnose_gap(nominal(), Dataset(wrong))


DEGREES = np.array([1.0, 180 / np.pi])
LATE = [0, *range(299)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda q, v, u: (q * DEGREES[1], v * DEGREES[1], u),
            "shoulder and elbow look recorded in degrees; convert to",
        ),
        (
            lambda q, v, u: (q * DEGREES, v * DEGREES, u),
            "fit the model: elbow looks recorded in degrees; convert to rad",
        ),
        (lambda q, v, u: (q, v, 100 * u), "commands look 100 times too large, as in percent"),
        (lambda q, v, u: (q, v, u / 1000), "commands look 1000 times too small"),
        (lambda q, v, u: (q, v, u[LATE]), "commands look one row late: ctrl\\[r\\] must act from row r to row r\\+1"),
        (lambda q, v, u: (q * [1, 0] + [0, 0.2], v * [1, 0], u), "elbow: its readings never change, qpos 0.2 rad"),
    ],
)
def test_units_rows_and_dead_encoders_are_named(change, words):
    """Degrees in all joints or in one, commands that are logged a row late and an encoder that stands still."""
    wrong = [Episode(e.name, e.time, *change(e.qpos, e.qvel, e.ctrl)) for e in record(noise=1e-3)]
    with pytest.raises(BadDataset, match=words):
        checked(nominal(), Dataset(wrong))


def checked(model, data):
    """Run all checks of a diagnosis and nothing else."""
    check_readings(model, data)
    check_fit(Replay(model, None, []), data, cut_recordings(data, 0, 0, 60), np.zeros(0))


def test_degrees_that_make_the_simulation_diverge():
    """Speeds so high that the nominal model's simulation blows up: the words still say degrees."""
    stiff = ARM.replace('damping="0.05"', 'damping="0.05" stiffness="1000" limited="true" range="-90 90"')
    quick = mujoco.MjModel.from_xml_string(stiff.replace('integrator="implicitfast"', 'integrator="Euler"'))
    assert quick.jnt_limited.all()
    data = record(lambda model: model.jnt_stiffness.__setitem__(slice(None), 1000.0))
    wrong = [Episode(e.name, e.time, e.qpos * DEGREES[1], e.qvel * DEGREES[1], e.ctrl) for e in data]
    with pytest.raises(BadDataset, match="look recorded in degrees"):
        checked(quick, Dataset(wrong))


SERVO = """
<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body>
  <joint name="hinge" axis="0 1 0" damping=".1" armature=".01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1"/></body></worldbody>
<actuator><position joint="hinge" kp="{kp}" kv="{kv}"/></actuator></mujoco>
"""


def servo(kp, kv):
    return mujoco.MjModel.from_xml_string(SERVO.format(kp=kp, kv=kv))


def follow(kp, kv, noise, rate=1.0, late=0, rows=200):
    """Recordings of a servo that follows smooth sines of about a rate [Hz], its commands logged some rows late."""
    model, rng, out = servo(kp, kv), np.random.default_rng(0), []
    data = mujoco.MjData(model)
    for number in range(4):
        mujoco.mj_resetData(model, data)
        rates, phase = rate * rng.uniform(0.5, 1.5, (3, 1)), rng.uniform(0, 6, (3, 1))
        ctrl = np.sin(2 * np.pi * rates * 0.01 * np.arange(rows) + phase).sum(0)[:, None] / 3
        qpos, qvel = np.empty((rows, 1)), np.empty((rows, 1))
        for row in range(rows):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            mujoco.mj_step(model, data, 10)
        qpos += noise * rng.normal(size=qpos.shape)
        qvel += 8 * noise * rng.normal(size=qvel.shape)
        logged = np.concatenate([ctrl[:1].repeat(late, axis=0), ctrl[: rows - late]])
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, logged))
    return Dataset(out)


@pytest.mark.parametrize("noise", [0.0, 3e-3, 3e-2])
@pytest.mark.parametrize(
    ("nominal_gains", "gains", "rate"),
    [((100, 3), (150, 3), 1.0), ((100, 3), (50, 1), 1.0), ((400, 10), (600, 10), 3.0)],
)
def test_a_stiffer_servo_is_no_late_log(nominal_gains, gains, rate, noise):
    """A servo that leads the model's by about a row, on commands so smooth that a shift would nearly cure it."""
    checked(servo(*nominal_gains), follow(gains[0], gains[1], noise, rate))


def test_a_servos_late_log_is_named():
    """The same servo as the model's, with its commands a row late."""
    with pytest.raises(BadDataset, match="commands look one row late"):
        checked(servo(100, 3), follow(100, 3, 1e-5, late=1))


CARTS = """
<mujoco><option timestep="0.01" integrator="implicitfast"/><worldbody>
  <body><joint name="left" type="slide" axis="1 0 0" damping="1"/><geom size=".1" mass="1" contype="0"/></body>
  <body><joint name="right" type="slide" axis="1 0 0" damping="1"/><geom size=".1" mass="1" contype="0"/></body>
</worldbody><actuator><motor joint="left"/><motor joint="right"/></actuator></mujoco>
"""


def carts(late, noise):
    """Two carts driven by white commands, those of each logged some rows late, and noise [m/s] on each one's speed."""
    model, rng = mujoco.MjModel.from_xml_string(CARTS), np.random.default_rng(0)
    data, rows = mujoco.MjData(model), 300
    ctrl, qpos, qvel = rng.normal(size=(rows, 2)), np.empty((rows, 2)), np.empty((rows, 2))
    for row in range(rows):
        qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
        mujoco.mj_step(model, data)
    qvel += noise * rng.normal(size=qvel.shape)
    logged = np.column_stack([np.roll(ctrl[:, k], rows_late) for k, rows_late in enumerate(late)])[1:]
    return model, Dataset([Episode("0", 0.01 * np.arange(rows - 1), qpos[1:], qvel[1:], logged)])


@pytest.mark.parametrize(
    ("late", "noise", "refused"),
    [((1, 1), (0.005, 0.003), True), ((0, 1), (0.005, 0.003), False), ((1, 0), (1e-9, 0.003), False)],
)
def test_what_one_joint_says_of_late_logs_another_may_deny(late, noise, refused):
    """The noise is a third to a half of a command's step: a joint alone would tell, and half of them deny.

    However little noise a joint has, which makes of its share next to nothing, the other is heard.
    """
    model, data = carts(late, np.array(noise))
    with pytest.raises(BadDataset, match="commands look one row late") if refused else nullcontext():
        check_commands(Replay(model, None, []), data, np.zeros(0))


def rubbed(data):
    return -0.4 * np.tanh(data.qvel[1] / 0.05)


def delayed(rows):
    return [Episode(e.name, e.time, e.qpos, e.qvel, np.roll(e.ctrl, -rows, axis=0)) for e in record(noise=1e-3)]


@pytest.mark.parametrize(
    "data",
    [
        Dataset(delayed(1)),
        Dataset(delayed(3)),
        record(force=rubbed, noise=1e-3),
        record(lambda model: model.actuator_gear.__setitem__((1, 0), 0.3), noise=1e-3),
        record(lambda model: model.dof_armature.__setitem__(1, 0.2), noise=1e-3),
        record(force=lambda data: -6.0 * data.qpos[1], noise=1e-3),
    ],
    ids=["delay", "long delay", "friction", "weak motor", "rotor", "spring"],
)
def test_faults_pass_the_checks(data):
    """Real faults are the diagnosis' to name: none of them looks like recordings written down wrongly."""
    checked(nominal(), data)


def test_commands_that_never_change_pass():
    """An arm that swings under one constant torque says nothing of the rows of its commands."""
    model = nominal()
    data = mujoco.MjData(model)
    data.ctrl[:] = [0.5, 0.2]
    qpos, qvel = np.empty((400, 2)), np.empty((400, 2))
    for row in range(400):
        qpos[row], qvel[row] = data.qpos, data.qvel
        mujoco.mj_step(model, data, 2)
    ctrl = np.broadcast_to(data.ctrl, (400, 2))
    checked(model, Dataset([Episode("0", 0.01 * np.arange(400), qpos, qvel, ctrl)]))


def test_a_joint_that_nothing_moves_may_rest():
    """A second arm in the model's own rest, not driven and held by a spring, whose readings never change, is sound."""
    idle = """<body pos="1 0 1"><joint name="idle" axis="0 0 1"/><geom size=".1" mass="1"/></body></worldbody>"""
    model = mujoco.MjModel.from_xml_string(ARM.replace("</worldbody>", idle))
    rest = lambda x: np.hstack([x, np.zeros((len(x), 1))])  # noqa: E731
    data = [Episode(e.name, e.time, rest(e.qpos), rest(e.qvel), e.ctrl) for e in record(noise=1e-3)]
    checked(model, Dataset(data))


def test_a_model_that_diverges_is_refused():
    """Springs that push until the simulation blows up: the text says what to try, and no warning escapes."""
    wild = mujoco.MjModel.from_xml_string(ARM.replace('damping="0.05"', 'stiffness="-40000"'))
    with pytest.raises(SimulationDiverged, match=r"diverges from most recorded states.*halve its timestep"):
        diagnose_gap(wild, record())


def test_velocities_that_nobody_recorded_are_missed():
    """Positions that change beside velocities of zero cannot be a robot's."""
    data = Dataset([Episode(e.name, e.time, e.qpos, 0 * e.qvel, e.ctrl) for e in record()])
    with pytest.raises(BadDataset, match="shoulder: its qpos changes while its qvel stands still at 0"):
        diagnose_gap(nominal(), data)


@pytest.mark.parametrize(
    ("over", "named", "verdict"),
    [
        (0.9 * NEAR_FLOOR, False, "no_gap"),
        (0.9 * NEAR_FLOOR, True, "effects"),
        (1.1 * NEAR_FLOOR, False, "unexplained"),
        (1.1 * NEAR_FLOOR, True, "unexplained"),
    ],
)
def test_only_a_gap_surely_above_the_floor_is_unexplained(over, named, verdict):
    """The lower end of the ratio's interval decides, with three floors left at the estimate itself."""
    assert _verdict(Level(1.0, 0.9, 0.3, 0.1), over, 1.0, named=named) == verdict


def test_a_few_windows_far_beyond_all_noise_are_a_gap():
    """Where the mean is at the floor and nothing is named, windows that noise cannot explain are left unexplained."""
    assert _verdict(Level(1.0, 0.9, 0.3, 0.3), 1.0, 1e-6, named=False) == "unexplained"
    assert _verdict(Level(1.0, 0.9, 0.3, 0.3), 1.0, 1e-6, named=True) == "effects"


def test_most_of_a_gap_explained_is_explained():
    """Nine tenths of what there was beyond noise suffice for effects, whatever the rest is worth in noise."""
    assert _verdict(Level(1.0, 0.9, 0.05, 0.001), 50.0, 1.0, named=True) == "effects"
    assert _verdict(Level(1.0, 0.9, 0.05, 0.001), 50.0, 1.0, named=True, sound=False) == "unexplained"
    assert _verdict(Level(1.0, 0.9, 0.2, 0.001), 50.0, 1.0, named=True) == "unexplained"


SLED = """
<mujoco><option timestep="0.005" integrator="implicitfast"/>
<worldbody><geom type="plane" size="5 5 1" pos="0 0 {floor}" friction=".3"/>
  <body name="sled" pos="0 0 .101"><joint name="along" type="slide" axis="1 0 0"/>
    <joint name="up" type="slide" axis="0 0 1"/><geom type="box" size=".2 .2 .1" mass="1" friction=".3"/></body>
</worldbody>
<actuator><motor name="push" joint="along" gear="5"/></actuator></mujoco>
"""


def sled(floor=0.0):
    return mujoco.MjModel.from_xml_string(SLED.format(floor=floor))


def slide(model, up=1.0, rows=200, episodes=4):
    """A sled driven by sines at rising rates; `up` multiplies what is written down of its height."""
    out = []
    for number in range(episodes):
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 200)
        turn = 2 * np.pi * (0.6 + 0.3 * number) * 0.01 * np.arange(rows)
        ctrl = np.sin(np.outer(turn, np.arange(1, model.nu + 1)))
        qpos, qvel = np.empty((rows, 2)), np.empty((rows, 2))
        for row in range(rows):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos * [1, up], data.qvel * [1, up], ctrl[row]
            mujoco.mj_step(model, data, 2)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, ctrl))
    return Dataset(out)


def test_a_joint_that_rests_beside_its_zero_is_no_flipped_sign():
    """On a floor 2 mm too high a sled lies 1 mm above its zero; turned round it lies on the model's, as 2 mm lower."""
    recorded = slide(sled(0.002))
    assert min(e.qpos[:, 1].min() for e in recorded) > 0
    checked(sled(), recorded)


def test_a_sled_that_hops_on_a_high_floor_has_its_own_zero():
    """The shift that makes up for a floor that is higher is its height, whatever the sled's height is in the mean."""
    hopping = SLED.replace('gear="5"/>', 'gear="5"/><motor name="hop" joint="up" gear="9.9"/>')
    low, high = (mujoco.MjModel.from_xml_string(hopping.format(floor=height)) for height in (0.0, 0.005))
    recorded = slide(high)
    checked(low, recorded)
    windows = cut_recordings(recorded, 0, 0, 60).fit
    up = replace(windows, state=windows.state * [1, -1, 1, -1])
    replay, none = Replay(low, None, []), np.zeros(0)
    by_mean = checks._error(replay, none, mistakes.with_other_zeros(windows, up))
    assert checks._error_of_zeros(replay, none, windows, up, 0.0) < 1e-6 * by_mean


def test_a_sled_that_hops_upside_down_has_a_flipped_sign():
    """No other zero makes up for heights with the wrong sign where the sled leaves its floor."""
    hopping = SLED.replace('gear="5"/>', 'gear="5"/><motor name="hop" joint="up" gear="20"/>')
    model = mujoco.MjModel.from_xml_string(hopping.format(floor=0.0))
    checked(model, slide(model))
    with pytest.raises(BadDataset, match="up's sign looks flipped"):
        checked(model, slide(model, up=-1.0))
