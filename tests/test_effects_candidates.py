"""Where and in which sizes a diagnosis tries effects, counted in the scales of the recordings."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import DataScales, Effect, Quantity, all_candidates, effect_names, register, registry
from nfpde.errors import BadEffect
from nfpde.sim import MujocoSimulator, load_model
from tests.effect_checks import SERVO_ARM
from tests.models import BALL, BLOCK, DOUBLE_PENDULUM, FLYWHEEL, FREE_BOX, load, record

ROBOTS = {"arm": SERVO_ARM, "motors": DOUBLE_PENDULUM, "block": BLOCK, "box": FREE_BOX, "ball": BALL}

INVISIBLE = {
    "block": {("joint_offset", "x")},
    "ball": {("joint_offset", "before"), ("com_shift", "arm")},
    "box": {("ground_friction", None), ("contact_softness", None), ("ground_height", None)},
}
"""What changes nothing: where on a rail one is, the centre of what slides without turning, the floor under a flight."""

WHOLE_ROBOT = {"fluid_drag", "gravity_tilt", "time_scale", "wind"}
"""What every robot under gravity can have."""


@pytest.fixture(params=ROBOTS)
def robot(request):
    """A model, recordings of it, and their scales."""
    model = load_model(load(ROBOTS[request.param]))
    dataset = record(model, 2, 60, 4, amplitude=2.0)
    return request.param, model, dataset, DataScales.of(model, dataset)


def test_every_effect_is_tried_where_it_makes_sense(robot):
    """By the kind of robot: servos, contacts, commands, bodies that MuJoCo lets change."""
    name, model, _, scales = robot
    tried = {e.name for e in all_candidates(model, scales)}
    assert tried >= WHOLE_ROBOT
    contact = {"ground_friction", "contact_softness", "ground_height"}
    commands = {"motor_strength", "actuator_bias", "actuation_delay", "observation_delay", "actuator_lag", "dead_zone"}
    drives = {"torque_limit", "torque_speed", "load_friction", "backlash"}
    for readings in (commands, drives):
        readings |= {n for n in effect_names() if registry._REGISTRY[n].says in readings}
    of_servos = {"servo_gain", "joint_offset_logged", "sensor_scale_logged", "backlash_outer", "backlash_geared_outer"}
    of_servos |= {"motor_strength_command", "motor_strength_gear", "backlash_command"}
    expected = {
        "arm": set(effect_names()) - contact,
        "motors": set(effect_names()) - contact - of_servos,
        "block": set(effect_names()) - of_servos,
        "box": set(effect_names()) - of_servos - commands - drives,
        "ball": set(effect_names()) - of_servos - commands - drives,
    }[name]
    axes = {"coulomb_friction", "stribeck_friction", "viscous_damping", "joint_spring", "armature", "joint_offset"}
    axes |= {"sensor_scale", "sensor_scale_position"}
    if name == "box":
        expected -= axes
    if name == "ball":
        expected -= contact
    # the block slides without turning: MuJoCo has compiled its centre of mass in
    assert expected - tried <= ({"com_shift"} if name == "block" else set()), expected - tried
    assert tried - expected <= contact | commands | {"armature"}, tried - expected


def test_bounds_and_screened_values(robot):
    """Each candidate once, on an element that exists, inside what physics allows; values strictly inside its bounds."""
    _, model, _, scales = robot
    candidates = all_candidates(model, scales)
    places = [(e.name, e.target) for e in candidates]
    assert len(set(places)) == len(places)
    for e in candidates:
        e.bind(model)
        low, high = (np.array([getattr(p, side) for p in e.parameters]) for side in ("low", "high"))
        assert np.isfinite([low, high]).all()
        values = e.screened(scales)
        assert values.shape == (len(values), len(e.parameters)), e.name
        assert 1 <= len(values) <= 20, e.name
        assert ((low < values) & (values < high)).all(), (e.name, e.target)
        assert len(np.unique(values, axis=0)) == len(values), e.name


MAGNITUDES = ("control_dt", "position", "speed", "acceleration", "force actuator_force actuator_peak", "ctrl", "length")


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_no_magnitude_leads_beyond_what_physics_allows(robot, factor):
    """A robot that hardly moves, or that is huge: bounds are cut to what an effect's parameters may be."""
    _, model, _, scales = robot
    for names in MAGNITUDES:
        other = replace(scales, **{name: factor * getattr(scales, name) for name in names.split()})
        for e in all_candidates(model, other):
            for p, q in zip(e.parameters, e.quantities, strict=True):
                assert q.low <= p.low < p.high <= q.high, (names, p.name)


def test_every_candidate_shows(robot):
    """Some screened value of each changes the predictions of the robot's own recordings, and none is lost in NaN."""
    name, model, dataset, scales = robot
    windows = dataset.windows(10, history=20)
    windows = windows[np.flatnonzero(windows.row >= 20)][:6]
    unseen = []
    for e in all_candidates(model, scales):
        sim = MujocoSimulator(model, None, [e], check_influence=False)
        longest = sim.history_steps(windows.control_dt)
        own = windows if longest <= 20 else dataset.windows(10, history=longest)[:6]
        values = e.screened(scales)
        states = sim.rollout(
            np.vstack([sim.nominal()[None], values]),
            own,
            np.arange(len(values) + 1).repeat(len(own)),
            np.tile(np.arange(len(own)), len(values) + 1),
        ).reshape(len(values) + 1, len(own), -1)
        assert np.isfinite(states[0]).all()
        if not (np.abs(states[1:] - states[0]) > 1e-9).any():
            unseen.append((e.name, e.target))
    assert set(unseen) <= INVISIBLE.get(name, set()), unseen


def test_scales_of_a_known_motion():
    """A wheel under 0.1 Nm sin(w t): speed, acceleration, force and command are sines of known size."""
    model, w, dt = load_model(load(FLYWHEEL.format(integrator="Euler", frictionloss=0))), 6.0, 0.001
    t = np.arange(4189) * dt  # four turns of the sine, but for a millisecond
    qpos = -0.1 / 0.2 / w**2 * np.sin(w * t)
    qvel = -0.1 / 0.2 / w * np.cos(w * t)
    episode = Episode("0", time=t, qpos=qpos[:, None], qvel=qvel[:, None], ctrl=0.1 * np.sin(w * t)[:, None])
    scales = DataScales.of(model, Dataset([episode]))
    root = np.sqrt(0.5)
    assert scales.control_dt == pytest.approx(dt)
    # impacts are capped at the size of the largest fiftieth, which a sine has little above
    for got, size in (
        (scales.speed, 0.5 / w),
        (scales.position, 0.5 / w**2),
        (scales.acceleration, 0.5),
        (scales.force, 0.1),
        (scales.ctrl, 0.1),
        (scales.actuator_force, 0.1),
    ):
        assert got[0] == pytest.approx(root * size, rel=0.01)


RIG = """<mujoco><option timestep=".001" integrator="implicitfast"/><worldbody><geom type="plane" size="5 5 .1"/>
<body pos="0 0 .55"><joint name="height" type="slide" axis="0 0 1"/>
<geom size=".05" mass="2" contype="0" conaffinity="0"/>
<body><joint name="hip" axis="0 1 0" damping=".05"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.45" mass=".4"
contype="0" conaffinity="0"/><geom name="foot" size=".05" pos=".1 0 -.5" mass=".1"/></body></body></worldbody>
<actuator><motor name="hip" joint="hip"/></actuator></mujoco>"""


def test_errors_of_a_height_are_no_forces_of_the_joints():
    """A millimetre of error in a stiff ground pushes with several weights; a joint's force stays its drive's."""
    model, rng = load_model(load(RIG)), np.random.default_rng(0)
    data = mujoco.MjData(model)
    rows, ctrl = [], 3.0 * np.sin(np.arange(400) * 0.05)
    for u in ctrl:
        data.ctrl[:] = u
        rows.append(np.concatenate([data.qpos, data.qvel]))
        mujoco.mj_step(model, data, 5)
    states = np.array(rows)
    touched = states.copy()
    touched[:, 0] += 1e-3 * rng.normal(size=len(states))

    def scales(x):
        return DataScales.of(model, Dataset([Episode("0", 0.005 * np.arange(400), x[:, :2], x[:, 2:], ctrl[:, None])]))

    drive = np.sqrt((ctrl**2).mean())
    for x in (states, touched):
        # between a drive that works against the ground and one that swings a free leg
        assert 0.05 * drive < scales(x).force[1] < 1.01 * drive


def test_sizes_follow_the_robot():
    """A robot with all masses, torques and dampings ten times as large moves alike: forces to try are ten times."""
    model = load_model(load(DOUBLE_PENDULUM))
    big = copy.copy(model)
    for field in ("body_mass", "body_inertia", "dof_damping", "dof_armature", "actuator_gainprm"):
        getattr(big, field)[...] *= 10
    big = load_model(big)  # which derives the masses of subtrees
    dataset = record(model, 2, 60, 4, amplitude=2.0)
    small, large = ({(e.name, e.target): e for e in all_candidates(m, DataScales.of(m, dataset))} for m in (model, big))
    assert small.keys() == large.keys()
    for name, target, parameter, factor in [
        ("coulomb_friction", "elbow", 0, 10),
        ("stribeck_friction", "elbow", 2, 1),
        ("viscous_damping", "elbow", 0, 10),
        ("joint_spring", "elbow", 0, 10),
        ("armature", "elbow", 0, 10),
        ("torque_limit", "shoulder", 0, 10),
        ("payload", "lower", 0, 10),
        ("payload", "lower", 1, 1),
        ("external_force", "lower", 0, 10),
        ("actuation_delay", "*", 0, 1),
        ("dead_zone", "elbow_motor", 0, 1),
        ("joint_offset", "elbow", 0, 1),
    ]:
        one, other = (c[name, target].parameters[parameter].high for c in (small, large))
        assert other == pytest.approx(factor * one, rel=1e-6), name


FLANGED = """<mujoco><worldbody><body name="arm"><joint name="pan"/>
<geom type="capsule" fromto="0 0 0 .6 0 0" size=".05"/><body name="flange" pos=".6 0 0"><joint name="turn"/>
<geom type="capsule" fromto="0 0 0 0 0 -.05" size=".02"/></body>
</body></worldbody></mujoco>"""


def test_a_small_flange_may_hold_a_long_tool():
    """As long as the arm before it, which alone is held to its own size; so is a flange on nothing that moves."""
    model = load_model(load(FLANGED))
    scales = DataScales.of(model, record(model, 2, 20, 4))
    found = {e.target: e.parameters for e in all_candidates(model, scales) if e.name == "payload"}
    arm, tool = (0.5 * (found[body][3].high - found[body][3].low) for body in ("arm", "flange"))
    assert arm == pytest.approx(1.5 * 0.35)  # half its length and the radius
    assert tool == pytest.approx(0.35)
    fixed = load_model(load(FLANGED.replace('<joint name="pan"/>', "")))
    alone = next(e for e in all_candidates(fixed, DataScales.of(fixed, record(fixed, 2, 20, 4))) if e.name == "payload")
    assert alone.parameters[3].high - alone.parameters[3].low == pytest.approx(2 * 1.5 * 0.045)


def test_effects_can_be_left_out():
    """By name; a name that no effect has is an error."""
    model = load_model(load(DOUBLE_PENDULUM))
    scales = DataScales.of(model, record(model, 1, 20, 4))
    every, fewer = all_candidates(model, scales), all_candidates(model, scales, exclude=("wind", "payload"))
    assert [(e.name, e.target) for e in every if e.name not in ("wind", "payload")] == [
        (e.name, e.target) for e in fewer
    ]
    with pytest.raises(BadEffect, match="no effect is called 'winds'; known: actuation_delay, "):
        all_candidates(model, scales, exclude=["winds"])


def test_an_own_effect_is_tried_by_its_default_bounds(monkeypatch):
    """On every element of its kind, at values between neutral and the bounds."""
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))

    @register
    class Hum(Effect):
        name = "hum"
        kind = "joint"
        quantities = (Quantity("size", "Nm", 0.0, 10.0, neutral=0.0),)
        default_bounds = {"size": (0.0, 2.0)}  # noqa: RUF012
        sentence = "It hums."

    model = load_model(load(DOUBLE_PENDULUM))
    scales = DataScales.of(model, record(model, 1, 20, 4))
    found = [e for e in all_candidates(model, scales) if e.name == "hum"]
    assert [e.target for e in found] == ["shoulder", "elbow"]
    values = found[0].screened(scales)
    assert (np.diff(values[:, 0]) > 0).all()
    assert 0 < values.min() < 0.2 < 0.5 < values.max() < 2


@pytest.mark.parametrize(
    ("bounds", "tried"),
    [((-1.0, 2.0), (0.0, 2.0)), ((5.0, 50.0), (5.0, 10.0)), ((20.0, 30.0), None), ((-2.0, 0.0), None)],
)
def test_bounds_beyond_physics_are_cut(monkeypatch, bounds, tried):
    """To what is allowed; where nothing is left, there is no candidate."""
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))

    @register
    class Buzz(Effect):
        name = "buzz"
        kind = None
        quantities = (Quantity("size", "Nm", 0.0, 10.0, neutral=0.0),)
        sentence = "It buzzes."

        @classmethod
        def bounds_for(cls, model, element, scales):
            return {"size": bounds}

    model = load_model(load(DOUBLE_PENDULUM))
    found = Buzz.candidates(model, DataScales.of(model, record(model, 1, 20, 4)))
    assert [(e.parameters[0].low, e.parameters[0].high) for e in found] == ([] if tried is None else [tried])
