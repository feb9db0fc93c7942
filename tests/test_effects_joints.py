"""Effects in joints, against plain MuJoCo and by hand."""

import mujoco
import numpy as np
import pytest

from nfpde.effects import LINEAR, DataScales, all_candidates, effect, slides
from nfpde.errors import BadEffect
from nfpde.sim import MujocoSimulator
from tests.effect_checks import SERVO_ARM, make, neutral_does_nothing, recording, replaced, rows_are_apart, same_as
from tests.models import BALL, FLYWHEEL, load, make_windows, plain_rollout, record

ELBOW = 'name="elbow" axis="0 1 0" damping="0.1" armature="0.01"'

JOINT_EFFECTS = [
    ("viscous_damping", {"damping": (0, 2)}, [[0.3], [1.5]]),
    ("armature", {"inertia": (0, 1)}, [[0.02], [0.3]]),
    ("joint_spring", {"stiffness": (0, 50), "rest": (-2, 2)}, [[3.0, 0.5], [20.0, -0.4]]),
    ("load_friction", {"base": (0, 2), "share": (0, 1)}, [[0.2, 0.0], [0.1, 0.3]]),
    ("coulomb_friction", {"torque": (0, 2)}, [[0.2], [0.8]]),
    ("stribeck_friction", {"coulomb": (0, 2), "static": (0, 2), "speed": (0.01, 1)}, [[0.1, 0.3, 0.1], [0.2, 0.9, 1]]),
]


@pytest.mark.parametrize(("name", "bounds", "values"), JOINT_EFFECTS)
def test_neutral_and_rows(name, bounds, values):
    """Neutral rows are untouched by active ones beside them, and rows with other values do not mix."""
    sim = make(name, "elbow", **bounds)
    neutral_does_nothing(sim, values)
    rows_are_apart(sim, values)


def test_viscous_damping_adds_to_the_models():
    """MJCF with the sum of both dampings."""
    sim = make("viscous_damping", "elbow", damping=(0, 2))
    same_as(sim, [0.7], replaced(ELBOW, 'name="elbow" axis="0 1 0" damping="0.8" armature="0.01"'))


def test_viscous_damping_stops_a_wheel_exponentially():
    """v(t) = v(0) exp(-t d / I) with I = 0.2 kg m²."""
    sim = make("viscous_damping", "axle", FLYWHEEL.format(integrator="implicitfast", frictionloss=0), damping=(0, 2))
    windows = make_windows(sim.model, 2, 500)
    windows.ctrl.setflags(write=True)
    windows.ctrl[:] = 0
    speed = sim.predict([[0.4]], windows)[0, :, :, 1]
    expected = windows.start[:, None, 1] * np.exp(-0.4 / 0.2 * 0.001 * np.arange(1, 501))
    # an implicit step of 1 ms is off by half of (dt d / I)^2 a step
    np.testing.assert_allclose(speed, expected, rtol=2e-3)


def test_armature_adds_to_the_models():
    """MJCF with the sum of both."""
    sim = make("armature", "elbow", inertia=(0, 2))
    same_as(sim, [0.04], replaced(ELBOW, 'name="elbow" axis="0 1 0" damping="0.1" armature="0.05"'))


@pytest.mark.parametrize("own", [0.0, 4.0])
def test_joint_spring_is_mujocos(own):
    """A spring about another rest position, beside one that the model has already."""
    xml = replaced(ELBOW, f'{ELBOW} stiffness="{own}"')
    model = load(xml)
    joint = model.joint("elbow")
    # k1 (q - r1) + k2 (q - r2) is one spring: the sum about the weighted mean
    model.jnt_stiffness[joint.id] = own + 7.0
    model.qpos_spring[joint.qposadr[0]] = 7.0 * 0.6 / (own + 7.0)
    same_as(make("joint_spring", "elbow", xml, stiffness=(0, 50), rest=(-2, 2)), [7.0, 0.6], model)


def test_load_friction_follows_the_torque_that_mujoco_transmits():
    """dof_frictionloss set by hand from MuJoCo's own qfrc_actuator, for a servo, a geared one and a motor."""
    for joint in ("shoulder", "elbow", "wrist"):
        sim = make("load_friction", joint, base=(0, 2), share=(0, 1))
        dof = sim.model.joint(joint).dofadr[0]

        def rub(model, data, dof=dof):
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fwdActuation(model, data)
            model.dof_frictionloss[dof] = 0.1 + 0.25 * abs(data.qfrc_actuator[dof])

        same_as(sim, [0.1, 0.25], SERVO_ARM, rub)


def test_load_friction_is_recovered_from_data():
    """Of a grid of shares the recorded one has the least loss."""
    truth = load(SERVO_ARM)

    def rub(model, data):
        mujoco.mj_forward(model, data)
        model.dof_frictionloss[1] = 0.05 + 0.3 * abs(data.qfrc_actuator[1])

    rng = np.random.default_rng(0)
    ctrl = rng.uniform(-1, 1, (200, 3))
    states = plain_rollout(truth, np.zeros(6), ctrl, 4, rub)
    windows = recording(np.vstack([np.zeros(6), states[:-1]]), ctrl, truth, 0.008).windows(10)
    sim = make("load_friction", "elbow", base=(0, 2), share=(0, 1))
    grid = np.linspace(0, 0.6, 25)
    losses = sim.losses(np.stack([np.full(25, 0.05), grid], 1), windows, np.ones(6)).sum(1)
    assert grid[losses.argmin()] == pytest.approx(0.3)
    assert losses.min() < 1e-6 * losses[0]


def test_damping_and_friction_compose_in_any_order():
    """Three effects on one joint move it as MJCF with all three."""
    chosen = [
        effect("viscous_damping", "elbow", damping=(0, 2)),
        effect("coulomb_friction", "elbow", torque=(0, 2)),
        effect("armature", "elbow", inertia=(0, 2)),
    ]
    values = [0.3, 0.2, 0.02]
    xml = replaced(ELBOW, 'name="elbow" axis="0 1 0" damping="0.4" armature="0.03" frictionloss="0.2"')
    for order in ([0, 1, 2], [2, 0, 1]):
        sim = MujocoSimulator(load(SERVO_ARM), None, [chosen[i] for i in order])
        same_as(sim, [values[i] for i in order], xml)


def test_springs_and_load_friction_need_an_axis():
    """A ball joint has no single position; a joint that nothing drives transmits no torque."""
    with pytest.raises(BadEffect, match="hinge"):
        make("joint_spring", "ball", BALL, stiffness=(0, 1), rest=(-1, 1))
    with pytest.raises(BadEffect):
        make("load_friction", "after", BALL, base=(0, 1), share=(0, 1))


def test_damping_is_recovered_from_data():
    """Of 41 values the recorded one has the least loss."""
    truth = load(replaced(ELBOW, 'name="elbow" axis="0 1 0" damping="0.35" armature="0.01"'))
    windows = record(truth, 2, 60, 5).windows(10)
    sim = make("viscous_damping", "elbow", damping=(0, 1))
    grid = np.linspace(0, 1, 41)
    losses = sim.losses(grid[:, None], windows, np.ones(6)).sum(1)
    assert grid[losses.argmin()] == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("name", "field"), [("viscous_damping", "dof_damping"), ("coulomb_friction", "dof_frictionloss")]
)
def test_a_ball_is_held_back_about_every_axis(name, field):
    """As MuJoCo's own field does it, and a diagnosis tries it there."""
    model = load(BALL)
    ball = int(np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_BALL))[0])
    dofs = model.jnt_dofadr[ball] + np.arange(3)
    data = record(model, 3, 40, 5)
    tried = [e for e in all_candidates(model, DataScales.of(model, data)) if e.name == name]
    bound = next(e.bind(model) for e in tried if set(dofs) <= set(e.bind(model).dofs.tolist()))
    value = 0.5 * bound.parameters[0].high
    sim = MujocoSimulator(model, None, [bound], check_influence=False)
    held = load(BALL)
    getattr(held, field)[dofs] += value
    windows = make_windows(model, 3, 20)
    found = sim.predict([[value]], windows)[0]
    for n in range(3):
        free, expected = (plain_rollout(m, windows.start[n], windows.ctrl[n], 1) for m in (model, held))
        np.testing.assert_allclose(found[n], expected, atol=1e-9)
        assert np.abs(found[n] - free).max() > 1e-4


def test_units_along_a_slide():
    """A force in N is named for what it is, a torque too."""
    model = load(CART)
    for target, slide in (("rail", True), ("pole", False)):
        assert slides(model, effect("coulomb_friction", target, torque=(0, 1))) is slide
    assert slides(model, effect("torque_limit", "push", limit=(0, 1)))
    assert not slides(model, effect("payload", "cart", mass=(0, 1), **{f"position_{a}": (-1, 1) for a in "xyz"}))
    assert LINEAR["Nms/rad"] == "Ns/m"


CART = """
<mujoco><worldbody><body name="cart"><joint name="rail" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/>
  <body><joint name="pole" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .5" size=".02" mass=".2"/></body>
</body></worldbody><actuator><motor name="push" joint="rail"/></actuator></mujoco>
"""


FLOATING = """
<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 1">
      <freejoint name="root"/>
      <geom size="0.1"/>
      <body pos="0.2 0 0"><joint name="ball" type="ball"/><geom type="capsule" fromto="0 0 0 0.1 0 -0.3" size="0.03"/>
        <body pos="0.1 0 -0.3"><joint name="knee" axis="0 1 0"/><geom size="0.03" pos="0 0 -0.2"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
"""A trunk in the air, with a ball joint and a hinge."""

BEARINGS = [
    (name, bounds, values[-1])
    for name, bounds, values in JOINT_EFFECTS
    if name not in ("joint_spring", "load_friction")
]


@pytest.mark.parametrize(("name", "bounds", "values"), BEARINGS)
def test_all_joints_are_those_with_a_bearing(name, bounds, values):
    """With "*" nothing holds the trunk by the air: the same as to name every joint but the free one."""
    every, named = (make(name, target, FLOATING, **bounds) for target in ("*", ("ball", "knee")))
    np.testing.assert_array_equal(every.effects[0].dofs, 6 + np.arange(4))
    windows = make_windows(every.model, 2, 6, nsub=4)
    np.testing.assert_array_equal(every.predict([values], windows), named.predict([values], windows))


@pytest.mark.parametrize(("name", "bounds", "values"), BEARINGS)
def test_a_free_joint_has_no_bearing(name, bounds, values):
    """By name, among others, or as the only joint there is, it is an error."""
    alone = FLOATING[: FLOATING.index('<body pos="0.2')] + "</body></worldbody></mujoco>"
    for target, xml in (("root", FLOATING), (("root", "knee"), FLOATING), ("*", alone)):
        with pytest.raises(BadEffect, match=rf"{name} on .*: it needs hinges, slides or balls, .* a free joint has no"):
            make(name, target, xml, **bounds)
