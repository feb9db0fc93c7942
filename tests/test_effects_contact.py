"""Effects of the ground, against plain MuJoCo and mechanics."""

from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.effects import DataScales, all_candidates
from nfpde.errors import BadEffect
from nfpde.sim import load_model
from tests.effect_checks import SERVO_ARM, make, neutral_does_nothing, predict, replaced, rows_are_apart, same_as
from tests.models import BLOCK, load, make_windows, record, with_arrays

PAIRED = BLOCK.replace(
    "<actuator>",
    '<contact><pair geom1="floor" geom2="box" friction="0.3 0.3 0.005 0.0001 0.0001"/></contact><actuator>',
)
SOFT: dict[str, Any] = {"time_constant": (0.004, 0.3), "damping_ratio": (0.05, 4)}


def slide(sim, value, push, steps=300, speed=0.0):
    """Speed [m/s] of the block along x after every step under a constant push [N], starting at rest on the floor."""
    windows = make_windows(sim.model, 1, steps)
    state = np.zeros_like(windows.state)
    state[0, 0, 2] = speed
    windows = with_arrays(windows, state=state, ctrl=np.full_like(windows.ctrl, push))
    return predict(sim, [value], windows)[0, 0, :, 2]


@pytest.mark.parametrize(
    ("name", "bounds", "values"),
    [
        ("ground_friction", {"sliding": (0.01, 3)}, [[0.1], [0.9]]),
        ("contact_softness", SOFT, [[0.05, 1.0], [0.02, 0.2]]),
        ("ground_height", {"height": (-0.05, 0.05)}, [[0.01], [0.03]]),
    ],
)
@pytest.mark.parametrize("xml", [BLOCK, PAIRED])
def test_neutral_and_rows(name, bounds, values, xml):
    """Neutral rows are untouched by active ones beside them, and rows with other values do not mix."""
    sim = make(name, None, xml, **bounds)
    neutral_does_nothing(sim, values, xml, spread=0.01)
    rows_are_apart(sim, values, spread=0.001)


@pytest.mark.parametrize("coefficient", [0.1, 0.8])
def test_ground_friction_is_that_of_both_geoms(coefficient):
    """Lower and higher than both geoms': MJCF with the coefficient on both, and in a pair."""
    sim = make("ground_friction", None, BLOCK, sliding=(0.01, 3))
    xml = BLOCK.replace('friction="0.2 0.005', f'friction="{coefficient} 0.005')
    xml = xml.replace('friction="0.5 0.005', f'friction="{coefficient} 0.005')
    same_as(sim, [coefficient], xml, spread=0.005)
    sim = make("ground_friction", None, PAIRED, sliding=(0.01, 3))
    same_as(sim, [coefficient], replaced('"0.3 0.3', f'"{coefficient} {coefficient}', PAIRED), spread=0.005)


@pytest.mark.parametrize("coefficient", [0.1, 0.8])
def test_ground_friction_brakes_a_sliding_block(coefficient):
    """Nothing pushes: in 0.2 s the block loses mu g 0.2 s of its speed."""
    xml = BLOCK.replace('timestep="0.002"', 'timestep="0.002" cone="elliptic"')
    sim = make("ground_friction", None, xml, sliding=(0.01, 3))
    speed = slide(sim, [coefficient], 0.0, speed=5.0)
    # the block settles on the floor at first
    assert speed[150] - speed[250] == pytest.approx(coefficient * 9.81 * 0.2, rel=0.05)


def ranked(of_floor, of_box):
    """The block and its floor with priorities, which decide whose numbers count."""
    xml = replaced('friction="0.2 0.005', f'priority="{of_floor}" friction="0.2 0.005', BLOCK)
    return replaced('friction="0.5 0.005', f'priority="{of_box}" friction="0.5 0.005', xml)


PRIORITIES = [(0, 0), (1, 0), (0, 1), (2, 1)]


@pytest.mark.parametrize("priorities", PRIORITIES)
@pytest.mark.parametrize("coefficient", [0.1, 0.35, 0.8])
def test_ground_friction_brakes_whatever_the_priorities(coefficient, priorities):
    """Below, between and above the geoms' own: the block loses mu g 0.2 s of its speed, as in the test above."""
    xml = replaced('timestep="0.002"', 'timestep="0.002" cone="elliptic"', ranked(*priorities))
    sim = make("ground_friction", None, xml, sliding=(0.01, 3))
    speed = slide(sim, [coefficient], 0.0, speed=5.0)
    assert speed[150] - speed[250] == pytest.approx(coefficient * 9.81 * 0.2, rel=0.05)


@pytest.mark.parametrize("weights", [(3, 1), (0, 0), (0, 1)])
@pytest.mark.parametrize("priorities", PRIORITIES)
def test_neutral_is_what_contacts_have(priorities, weights):
    """Friction and give of MuJoCo's own contact, from one geom alone or mixed of both."""
    xml = replaced('name="floor"', f'name="floor" solmix="{weights[0]}" solref="0.03 0.9"', ranked(*priorities))
    xml = replaced('name="box"', f'name="box" solmix="{weights[1]}" solref="0.05 1.2"', xml)
    model = load(xml)
    data = mujoco.MjData(model)
    data.qpos[1] = -0.001
    mujoco.mj_forward(model, data)
    sim = make("ground_friction", None, xml, sliding=(0.01, 3))
    np.testing.assert_array_equal(sim.nominal(), data.contact[0].friction[:1])
    sim = make("contact_softness", None, xml, **SOFT)
    np.testing.assert_allclose(sim.nominal(), data.contact[0].solref, rtol=1e-14)


def test_stiffness_and_damping_count_where_contacts_take_them():
    """A ground that says them is refused, unless the block's own time constant has priority."""
    stiff = 'name="floor" solref="-100 -5"'
    with pytest.raises(BadEffect, match=r"stiffness and damping \(-100.0, -5.0\)"):
        make("contact_softness", None, replaced('name="floor"', stiff, ranked(0, 0)), **SOFT)
    sim = make("contact_softness", None, replaced('name="floor"', stiff, ranked(0, 1)), **SOFT)
    np.testing.assert_array_equal(sim.nominal(), [0.02, 1.0])


MANY = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" friction="0.6 0.005 0.0001"/>
    <geom name="mat" type="plane" size="5 5 1" priority="2" friction="1.2 0.005 0.0001"/>
    <body name="robot" pos="0 0 0.099">
      <freejoint/>
      <geom name="plain" type="box" size="0.1 0.1 0.1" friction="0.4 0.005 0.0001"/>
      <geom name="rubber" type="box" size="0.1 0.1 0.1" pos="0 1 0" priority="1" friction="0.8 0.005 0.0001"/>
      <geom name="foot" type="box" size="0.1 0.1 0.1" pos="0 2 0" priority="3" friction="0.9 0.005 0.0001"/>
      <geom name="paired" type="box" size="0.1 0.1 0.1" pos="0 3 0" priority="3" friction="0.9 0.005 0.0001"/>
    </body>
  </worldbody>
  <contact><pair geom1="paired" geom2="floor" friction="0.3 0.3 0.005 0.0001 0.0001" solref="0.06 0.6"/></contact>
</mujoco>
"""
"""Geoms of four priorities that stand on two grounds, and a pair that overrules one of these contacts."""


@pytest.mark.parametrize(
    ("name", "bounds", "values"),
    [
        ("ground_friction", {"sliding": (0.01, 3)}, [[0.2], [0.7], [2.5]]),
        ("contact_softness", SOFT, [[0.06, 0.4], [0.01, 2.0]]),
    ],
)
def test_every_contact_with_the_world_has_the_value(name, bounds, values):
    """Each of MuJoCo's contacts of seven pairs of geoms, ranked and mixed in every way, and of an explicit pair."""
    sim = make(name, None, MANY, **bounds)
    for value in values:
        model = load(MANY)
        sim.writer.write(model, np.array(value))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert len({tuple(c.geom) for c in data.contact}) == 8
        for contact in data.contact:
            found = contact.friction[:2] if name == "ground_friction" else contact.solref
            np.testing.assert_allclose(found, np.broadcast_to(value, 2), rtol=1e-15)


def test_contact_softness_is_solref():
    """MJCF with that solref on every geom."""
    sim = make("contact_softness", None, BLOCK, **SOFT)
    xml = BLOCK.replace('friction="0.2 0.005 0.0001"', 'friction="0.2 0.005 0.0001" solref="0.06 0.4"')
    xml = xml.replace('friction="0.5 0.005 0.0001"', 'friction="0.5 0.005 0.0001" solref="0.06 0.4"')
    same_as(sim, [0.06, 0.4], xml, spread=0.005)


def test_ground_height_carries_the_block():
    """At rest the block stands higher or lower by the height."""
    sim = make("ground_height", None, BLOCK, height=(-0.05, 0.05))
    windows = make_windows(sim.model, 1, 1500)
    still = with_arrays(windows, state=np.zeros_like(windows.state), ctrl=np.zeros_like(windows.ctrl))
    flat, up, down = predict(sim, [[0.0], [0.03], [-0.02]], still)[:, 0, -1, 1]
    assert up - flat == pytest.approx(0.03, abs=1e-5)
    assert down - flat == pytest.approx(-0.02, abs=1e-5)


STEP = """
<mujoco>
  <worldbody>
    <body name="table" pos="0 0 0.1" quat="0.5 0.5 0.5 0.5">
      <geom name="top" type="box" size="0.3 0.5 0.4"/>
      <geom type="box" size="0.1 0.1 0.1" pos="0 2 0"/>
      <geom type="box" size="0.1 0.1 0.1" pos="0 -2 0"/>
    </body>
    <body name="block" pos="0 0 {z}">
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.05" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A ball above a table of several boxes, whose body is turned so that its y axis or another points up."""


@pytest.mark.parametrize("height", [0.2, -0.15])
def test_ground_height_is_vertical_whatever_the_frame_of_the_ground(height):
    """A ball that falls on a table in a turned body comes to rest higher or lower by the height."""
    model = load(STEP.format(z=1))
    top = model.geom("top").id
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    half = np.abs(data.geom_xmat[top].reshape(3, 3)[2]) @ model.geom_size[top]
    rest = 0.1 + half + 0.05
    xml = STEP.format(z=rest + 0.25)
    sim = make("ground_height", None, xml, height=(-0.5, 0.5))
    windows = make_windows(sim.model, 1, 2000)
    still = with_arrays(windows, state=np.zeros_like(windows.state))
    flat, moved = predict(sim, [[0.0], [height]], still)[:, 0, -1, 0]
    assert flat == pytest.approx(-0.25, abs=1e-3)
    assert moved - flat == pytest.approx(height, abs=1e-4)


@pytest.mark.parametrize("name", ["ground_friction", "contact_softness", "ground_height"])
def test_effects_of_the_ground_need_one(name):
    """An arm that touches nothing, and one whose geoms do not collide with the floor."""
    bounds = {"ground_friction": {"sliding": (0.1, 1)}, "contact_softness": SOFT, "ground_height": {"height": (-1, 1)}}
    apart = BLOCK.replace('type="plane"', 'type="plane" contype="0" conaffinity="0"').replace(
        'type="box"', 'type="box" contype="0" conaffinity="0"'
    )
    for xml in (SERVO_ARM, apart):
        with pytest.raises(BadEffect, match="nothing in this model can touch the world"):
            make(name, None, xml, **bounds[name])


@pytest.mark.parametrize(
    ("what", "name", "column"),
    [
        ('solref="0.02 0.01"', "contact_softness", 1),
        ('solref="0.000011 1"', "contact_softness", 0),
        ('friction="0.02"', "ground_friction", 0),
        ('friction="0"', "ground_friction", 0),
    ],
)
def test_what_is_unusual_in_the_model_is_among_what_is_tried(what, name, column):
    """Contacts that bounce, are very stiff, or slippery as no ice: nominal between the bounds, and no value twice."""
    xml = BLOCK.replace('friction="0.2 0.005 0.0001"', what).replace('friction="0.5 0.005 0.0001"', what)
    model = load_model(load(xml))
    scales = DataScales.of(model, record(model, 1, 40, 4))
    (tried,) = (e for e in all_candidates(model, scales) if e.name == name)
    own, bounds = tried.quantities[column].neutral, tried.parameters[column]
    assert own == pytest.approx(max(float(what.split('"')[1].split()[column]), mujoco.mjMINMU))
    assert bounds.low < own < bounds.high
    values = tried.screened(scales)
    assert len(np.unique(values, axis=0)) == len(values)
    assert ((bounds.low < values[:, column]) & (values[:, column] < bounds.high)).all()


def test_ground_friction_keeps_contacts_among_moving_parts_where_it_rises():
    """Only the world's geoms take a higher coefficient; the robot's take none above it."""
    ball = '<body name="other" pos="1 0 1"><freejoint/><geom size="0.1"/></body>'
    xml = replaced('<body name="block"', f'{ball}<body name="block"', BLOCK)
    sim = make("ground_friction", None, xml, sliding=(0.01, 3))
    friction = sim.writer.rows(np.array([[2.0], [0.1]]))["geom_friction"][:, :, 0]
    floor, box = sim.model.geom("floor").id, sim.model.geom("box").id
    assert friction[0, floor] == 2.0
    assert friction[0, box] == 0.5
    np.testing.assert_array_equal(friction[1], 0.1)
