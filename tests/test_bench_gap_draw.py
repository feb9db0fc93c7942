"""Systems of the gap benchmark: what is public, what is hidden, and that both are always the same."""

import ast
import json
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np
import pytest

from nfpde.bench.gap import sizes
from nfpde.bench.gap.catalog import EFFECTS, OUTSIDERS
from nfpde.bench.gap.draw import KINDS, Hidden, draw_system, entry, kind_of_turn
from nfpde.bench.gap.excite import SIGNALS, controller
from nfpde.bench.gap.nominal import nominal_model
from nfpde.bench.gap.pilot import pilot_of
from nfpde.bench.gap.plant import ALONE, Plant
from nfpde.bench.gap.record import Noise, episode, start_of
from nfpde.bench.gap.robots import ROBOTS
from nfpde.bench.gap.store import read_key, write_key, write_public
from nfpde.dataset import load_dataset
from nfpde.parameters import ParameterSpace

FOLDER = Path(__file__).parents[1] / "nfpde" / "bench" / "gap"

VOCABULARY = [
    "actuation_delay",
    "actuator_lag",
    "motor_strength",
    "actuator_bias",
    "torque_limit",
    "torque_speed",
    "dead_zone",
    "backlash",
    "servo_gain",
    "coulomb_friction",
    "stribeck_friction",
    "load_friction",
    "viscous_damping",
    "joint_spring",
    "armature",
    "joint_offset",
    "sensor_scale",
    "payload",
    "com_shift",
    "external_force",
    "gravity_tilt",
    "fluid_drag",
    "wind",
    "ground_friction",
    "contact_softness",
    "ground_height",
    "observation_delay",
    "time_scale",
]


@pytest.fixture(scope="module")
def system():
    """The first system of a seed that has one fault and free parameters."""
    for index in range(50):
        found = draw_system(3, index)
        if found.key["kind"] == "one" and found.free:
            return found
    raise AssertionError("no such system among 50")


def test_the_faults_are_independent_of_the_package():
    """Nothing that simulates, models effects or diagnoses is imported, at any place in any file."""
    forbidden = {"effects", "sim", "gap", "kernels", "estimation", "losses", "benchmarks"}
    for path in FOLDER.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                parts = name.split(".")
                assert parts[0] != "nfpde" or (len(parts) > 1 and parts[1] not in forbidden), f"{path.name}: {name}"
            assert not (isinstance(node, ast.ImportFrom) and node.level), f"{path.name}: relative import"


def test_every_effect_of_the_vocabulary_can_be_hidden():
    """The catalogue has each name once and nothing else, and each finds a place on some robot."""
    assert sorted(EFFECTS) == sorted(VOCABULARY)
    assert len(OUTSIDERS) >= 5
    assert not set(OUTSIDERS) & set(EFFECTS)
    models = {name: mujoco.MjModel.from_xml_path(str(robot.path)) for name, robot in ROBOTS.items()}
    for name, one in {**EFFECTS, **OUTSIDERS}.items():
        assert any(one.places(models[r], robot) for r, robot in ROBOTS.items()), name


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_are_described_as_they_are(name):
    """Every description fits its model, and every element has a name."""
    robot, model = ROBOTS[name], mujoco.MjModel.from_xml_path(str(ROBOTS[name].path))
    assert len(robot.home) == model.nq
    assert len(robot.start) == len(robot.speed) == model.nv
    assert len(robot.reach) == model.nu
    assert (robot.control_dt / model.opt.timestep) % 1 == pytest.approx(0, abs=1e-9)
    assert 50 <= 1 / robot.control_dt <= 200
    for kind, count in (("joint", model.njnt), ("actuator", model.nactuator), ("body", model.nbody)):
        assert all(getattr(model, kind)(i).name for i in range(count))


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("effect", [*EFFECTS, *OUTSIDERS])
def test_every_fault_runs_wherever_it_may_sit(name, effect):
    """On each robot that has a place for it, a fault leaves finite recordings for a second."""
    robot, rng = ROBOTS[name], np.random.default_rng(0)
    xml = nominal_model(robot, rng)
    sound = Plant(xml, robot.control_dt)
    places = entry(effect).places(sound.model, robot)
    if not places:
        pytest.skip("no place on this robot")
    quiet = Noise(np.zeros(sound.model.nv), np.zeros(sound.model.nv))
    bounds, rows = sound.model.actuator_ctrlrange, round(0.6 / robot.control_dt)
    start = start_of(robot, sound.model, rng)
    control = controller(robot, bounds[:, 0], bounds[:, 1], rows, rng)
    pilot = pilot_of(sound, [episode(sound, robot, start, control, rows, quiet, 0)])
    target = places[-1]
    one = entry(effect)
    values, seen = one.draw(pilot, robot, target, rng), []
    assert json.dumps(values)
    for meant in (one.fault, *(f for f in one.others if f.differs(sound.model, target))):
        fault = Hidden(effect, target, values, meant)
        run = episode(Plant(xml, robot.control_dt, faults=[fault.build()]), robot, start, control, rows, quiet, 0)
        assert run.stable
        assert np.isfinite(run.clean_qvel).all()
        seen.append(np.hstack([run.clean_qpos, run.clean_qvel]))
    if effect != "dead_zone":  # within whose zone a short motion may stay
        assert all(np.abs(a - b).max() > 0 for i, a in enumerate(seen) for b in seen[:i]), "two readings are one"


def test_half_of_the_systems_have_another_reading_where_there_is_one():
    """Of 400 draws within five standard errors of half, and no reading where it makes no difference."""
    model = mujoco.MjModel.from_xml_path(str(ROBOTS["servo4"].path))
    one, rng = entry("sensor_scale"), np.random.default_rng(0)
    joint = one.places(model, ROBOTS["servo4"])[0]
    drawn = [one.read(model, joint, rng) for _ in range(400)]
    assert 150 < drawn.count(one.fault) < 250
    assert set(drawn) == {one.fault, *one.others}
    motors = mujoco.MjModel.from_xml_path(str(ROBOTS["arm3"].path))
    strength = entry("motor_strength")
    driven = strength.places(motors, ROBOTS["arm3"])[0]
    differs = [f for f in strength.others if f.differs(motors, driven)]
    assert {strength.read(motors, driven, rng) for _ in range(50)} == {strength.fault, *differs}


@pytest.mark.parametrize("signal", SIGNALS)
def test_motions_stay_within_their_amplitude(signal):
    """Every signal keeps to [-1, 1] and moves."""
    wave = signal(500, 0.01, 2.0, np.random.default_rng(1))
    assert wave.shape == (500,)
    assert np.abs(wave).max() <= 1
    assert wave.std() > 0.1


def test_a_chirp_ends_at_its_frequency():
    """Over its last second a chirp to 2 Hz crosses zero about four times, over its first hardly once."""
    rng = np.random.default_rng(3)
    waves = [SIGNALS[0](1000, 0.01, 2.0, rng) for _ in range(20)]
    counts = [sorted((crossings(w[:100]), crossings(w[-100:]))) for w in waves]
    assert all(slow <= 1 and 3 <= fast <= 4 for slow, fast in counts)


def crossings(wave):
    return int((np.diff(np.sign(wave)) != 0).sum())


def test_a_seed_and_an_index_name_one_system(system):
    """Drawn again, a system is the same to the last bit; another index or seed gives another."""
    again = draw_system(system.key["seed"], system.key["index"])
    assert again.key == system.key
    assert again.xml == system.xml
    np.testing.assert_array_equal(again.runs[0].qpos, system.runs[0].qpos)
    assert draw_system(4, system.key["index"]).xml != system.xml


def test_kinds_take_turns_in_random_order():
    """Any 20 systems of one turn have what is meant of each kind, in an order that the seed decides."""
    for seed in range(5):
        turns = [[kind_of_turn(seed, 20 * turn + place) for place in range(20)] for turn in range(3)]
        assert all(Counter(turn) == KINDS for turn in turns)
        assert len({tuple(turn) for turn in turns}) == 3
    assert kind_of_turn(0, 7) == kind_of_turn(0, 7)
    assert len({tuple(kind_of_turn(seed, i) for i in range(20)) for seed in range(5)}) == 5


def test_public_files_load_and_hide_the_key(system, tmp_path):
    """Model, parameters and recordings fit together; no other file and no true value is there."""
    write_public(system.xml, system.free, system.robot, system.runs, tmp_path / "public")
    assert {p.name for p in (tmp_path / "public").iterdir()} == {"model.xml", "parameters.toml", "data.npz"}
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "public" / "model.xml"))
    data = load_dataset(tmp_path / "public" / "data.npz")
    space = ParameterSpace.from_toml(tmp_path / "public" / "parameters.toml")
    assert (data.nq, data.nv, data.nu) == (model.nq, model.nv, model.nu)
    assert data.control_dt == pytest.approx(system.robot.control_dt)
    for parameter, free in zip(space, system.free, strict=True):
        assert parameter.low <= free.true <= parameter.high
        assert parameter.low <= free.nominal <= parameter.high
    text = (tmp_path / "public" / "model.xml").read_text() + (tmp_path / "public" / "parameters.toml").read_text()
    assert not any(f"{free.true:.6g}" in text for free in system.free)


def test_a_key_is_read_back_and_nobody_else_may_enter_its_folder(system, tmp_path):
    """JSON there and back, mode 0700."""
    write_key(system.key, tmp_path / "keys" / "0.json")
    assert read_key(tmp_path / "keys" / "0.json") == json.loads(json.dumps(system.key))
    assert (tmp_path / "keys").stat().st_mode & 0o777 == 0o700


def runs_of(noise_level, faults, n=2, name="pendulum2"):
    """Recordings of a robot, the double pendulum unless told, and the plant that made them."""
    robot, rng = ROBOTS[name], np.random.default_rng(5)
    plant = Plant(robot.path.read_text(), robot.control_dt, faults=faults)
    noise = Noise(np.full(plant.model.nv, noise_level), np.full(plant.model.nv, 10 * noise_level))
    bounds = plant.model.actuator_ctrlrange
    runs = []
    for i in range(n):
        start, control = start_of(robot, plant.model, rng), controller(robot, bounds[:, 0], bounds[:, 1], 400, rng)
        runs.append(episode(plant, robot, start, control, 400, noise, i))
    return plant, runs


def test_the_true_robot_predicts_itself():
    """Without noise nothing is left over: the same steps from the same moments."""
    plant, runs = runs_of(0.0, [Hidden("actuation_delay", "all", {"delay": 0.017}).build()])
    at = sizes.windows(runs, 20, np.random.default_rng(0))
    assert np.abs(sizes.predict(plant, at, sizes.from_moment, clean=False)).max() < 1e-12


def test_what_no_motion_shows_has_no_size():
    """The zero of an upright axis is a convention: beside play as well, whose rotor turns with the zero."""
    hidden = [Hidden("backlash", "yaw_motor", {"width": 0.02}), Hidden("joint_offset", "yaw", {"offset": 0.08})]
    _, runs = runs_of(0.0, [h.build() for h in hidden], name="arm3")
    at = sizes.windows(runs, 40, np.random.default_rng(0))
    arm, traces = ROBOTS["arm3"], list[float]()
    for i, other in enumerate(reversed(hidden)):
        lacking = Plant(arm.path.read_text(), arm.control_dt, faults=[other.build()])
        traces.append(float(np.abs(sizes.predict(lacking, at, sizes.without(i), clean=True)).max()))
    assert traces[0] > 1e-2
    assert traces[1] < 1e-8  # rounding, magnified by stiff teeth


def test_the_floor_holds_the_noise_of_start_and_end():
    """At the first step a position's error is that of its start, of its end, and of the speed over the step."""
    plant, runs = runs_of(1e-3, [], n=12)
    at = sizes.windows(runs, 200, np.random.default_rng(0))
    _, spread = sizes.floor_of(plant, at)
    expected = np.sqrt(2 * 1e-6 + (10e-3 * 0.01) ** 2)
    assert spread[0, 0] == pytest.approx(expected, rel=0.2)  # 200 windows: 5 % standard error


def test_a_fault_that_free_constants_imitate_has_no_size():
    """Their own answer is taken out of a change entirely, the rest stays."""
    rng = np.random.default_rng(2)
    answer, rest = rng.normal(size=(30, 10, 4)), rng.normal(size=(30, 10, 4))
    scale = np.ones((10, 4))
    assert sizes.size(3 * answer, scale, [answer]) == pytest.approx(0, abs=1e-12)
    assert sizes.size(3 * answer + rest, scale, [answer]) == pytest.approx(sizes.size(rest, scale), rel=0.01)


def test_measured_values_carry_the_stated_noise():
    """The spread of measured minus clean positions is the noise's, and an encoder's grain divides the readings."""
    _, runs = runs_of(2e-3, [], n=4)
    error = np.concatenate([run.qpos - run.clean_qpos for run in runs])
    assert error.std() == pytest.approx(2e-3, rel=0.05)  # 3200 values: 1.3 % standard error
    robot, rng, grain = ROBOTS["pendulum2"], np.random.default_rng(1), 2 * np.pi / 4096
    plant = Plant(robot.path.read_text(), robot.control_dt)
    noise = Noise(np.full(2, 1e-4), np.zeros(2), grain)
    control = controller(robot, -np.ones(2), np.ones(2), 100, rng)
    run = episode(plant, robot, start_of(robot, plant.model, rng), control, 100, noise, 0)
    ticks = run.qpos / grain
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-6)


def test_physics_that_blows_up_is_noticed():
    """An absurd negative spring makes MuJoCo start anew, and the run says so."""
    robot, rng = ROBOTS["pendulum2"], np.random.default_rng(1)
    fault = Hidden("joint_spring", "elbow", {"stiffness": -1e9, "rest": 0.1}).build()
    plant = Plant(robot.path.read_text(), robot.control_dt, faults=[fault])
    control = controller(robot, -np.ones(2), np.ones(2), 50, rng)
    quiet = Noise(np.zeros(2), np.zeros(2))
    assert not episode(plant, robot, start_of(robot, plant.model, rng), control, 50, quiet, 0).stable


def test_base_constants_scale_a_body_as_a_whole_or_its_mass_alone():
    """Half the mass is half the inertia where it follows, and the damping is the one given."""
    robot = ROBOTS["pendulum2"]
    xml = robot.path.read_text()
    sound = Plant(xml, robot.control_dt).model
    body = sound.body("lower").id
    base = {("body_mass", "lower"): sound.body_mass[body] / 2, ("dof_damping", "elbow"): 0.5}
    other = Plant(xml, robot.control_dt, base).model
    np.testing.assert_allclose(other.body_inertia[body], sound.body_inertia[body] / 2)
    assert other.dof_damping[1] == 0.5
    loaded = Plant(xml, robot.control_dt, {(ALONE, "lower"): sound.body_mass[body] / 2}).model
    assert loaded.body_mass[body] == sound.body_mass[body] / 2
    np.testing.assert_array_equal(loaded.body_inertia[body], sound.body_inertia[body])
    with pytest.raises(ValueError, match="body_mass alone and dof_damping"):
        Plant(xml, robot.control_dt, {("jnt_range", "elbow"): 1.0})
