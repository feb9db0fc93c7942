"""Effects on bodies and on the world around them, against plain MuJoCo and mechanics."""

from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.sim import MujocoSimulator, load_model
from tests.effect_checks import SERVO_ARM, make, neutral_does_nothing, predict, replaced, rows_are_apart, same_as
from tests.models import FREE_BOX, load, make_windows, plain_rollout

PLACE: dict[str, Any] = {f"position_{axis}": (-1.0, 1.0) for axis in "xyz"}
SHIFT: dict[str, Any] = {f"shift_{axis}": (-0.5, 0.5) for axis in "xyz"}
FORCE: dict[str, Any] = {f"force_{axis}": (-50.0, 50.0) for axis in "xyz"}
WIND: dict[str, Any] = {f"velocity_{axis}": (-30.0, 30.0) for axis in "xyz"}
AIRY = SERVO_ARM.replace('timestep="0.002"', 'timestep="0.002" density="1.2" viscosity="1.8e-5"')


@pytest.mark.parametrize(
    ("name", "target", "bounds", "values", "xml"),
    [
        ("payload", "hand", {"mass": (0, 3), **PLACE}, [[0.5, 0.1, 0.05, -0.1], [2.0, 0, 0, 0]], SERVO_ARM),
        ("com_shift", "lower", SHIFT, [[0.1, 0, 0], [0, 0.1, -0.2]], SERVO_ARM),
        ("external_force", "hand", FORCE, [[3, 0, 0], [0, -4, 8]], SERVO_ARM),
        ("gravity_tilt", None, {"roll": (-1, 1), "pitch": (-1, 1)}, [[0.2, 0], [0.1, -0.3]], SERVO_ARM),
        ("fluid_drag", None, {"density": (0, 1e3), "viscosity": (0, 5)}, [[100, 0.1], [900, 2]], SERVO_ARM),
        ("wind", None, WIND, [[5, 0, 0], [0, 10, 3]], AIRY),
        ("wind", None, WIND, [[5, 0, 0], [0, 10, 3]], SERVO_ARM),
    ],
)
def test_neutral_and_rows(name, target, bounds, values, xml):
    """Neutral rows are untouched by active ones beside them, and rows with other values do not mix."""
    sim = make(name, target, xml, **bounds)
    neutral_does_nothing(sim, values, xml)
    rows_are_apart(sim, values)


def with_ball(xml, body, mass, position):
    """The model with a very small ball welded to a body."""
    spec = mujoco.MjSpec.from_string(xml)
    ball = spec.body(body).add_body(name="load", pos=list(position))
    ball.explicitinertial, ball.mass, ball.ipos, ball.inertia = True, mass, [0, 0, 0], [1e-11 * mass] * 3
    return spec.compile()


@pytest.mark.parametrize(("body", "place"), [("hand", (0.1, 0.05, -0.2)), ("lower", (-0.2, 0.1, 0.1))])
def test_payload_is_a_welded_point_mass(body, place):
    """The motion of a model to which a ball without size is welded, which MuJoCo composes itself."""
    sim = make("payload", body, mass=(0, 3), **PLACE)
    same_as(sim, [0.8, *place], with_ball(SERVO_ARM, body, 0.8, place), atol=1e-8)


def test_payload_keeps_the_inertia_of_the_sum():
    """Mass, centre and inertia tensor about the body's origin are those of the body plus those of the point."""
    sim = make("payload", "hand", mass=(0, 3), **PLACE)
    body, model = sim.model.body("hand").id, sim.model
    changed = sim.writer.rows(np.array([[0.8, 0.1, -0.2, 0.3]]))

    def about_origin(mass, centre, moments, quat):
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, quat)
        axes = turn.reshape(3, 3)
        return axes @ np.diag(moments) @ axes.T + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))

    fields = ("body_mass", "body_ipos", "body_inertia", "body_iquat")
    own = [getattr(model, f)[body] for f in fields]
    new = [changed[f][0][body] if f in changed else getattr(model, f)[body] for f in fields]
    p = np.array([0.1, -0.2, 0.3])
    assert new[0] == pytest.approx(own[0] + 0.8)
    np.testing.assert_allclose(new[0] * new[1], own[0] * own[1] + 0.8 * p, atol=1e-14)
    expected = about_origin(*own) + 0.8 * (p @ p * np.eye(3) - np.outer(p, p))
    np.testing.assert_allclose(about_origin(*new), expected, atol=1e-13)


def test_com_shift_is_an_inertial_elsewhere():
    """MJCF whose body says its inertial itself, with the centre moved."""
    sim = make("com_shift", "hand", **SHIFT)
    spec, shift = mujoco.MjSpec.from_string(SERVO_ARM), np.array([0.02, -0.03, 0.05])
    body, model = spec.body("hand"), sim.model
    i = model.body("hand").id
    body.explicitinertial, body.mass = True, model.body_mass[i]
    body.ipos, body.iquat, body.inertia = model.body_ipos[i] + shift, model.body_iquat[i], model.body_inertia[i]
    same_as(sim, shift, spec.compile())


def test_external_force_accelerates_a_free_body():
    """Force / mass, in the world's axes however the body turns; the turning itself is not changed."""
    xml = replaced("<mujoco>", '<mujoco><option gravity="0 0 0"/>', FREE_BOX)
    sim = make("external_force", "box", xml, **FORCE)
    windows = make_windows(sim.model, 3, 50, spread=0.5)
    force = np.array([3.0, -1.0, 2.0])
    pushed, free = predict(sim, [force, np.zeros(3)], windows)
    np.testing.assert_allclose(pushed[..., 10:], free[..., 10:], atol=1e-9)
    centre = np.array([0.01, 0, 0])  # of the box, in its frame; mass 1 kg

    def centres(states):
        turned = np.empty((*states.shape[:-1], 3))
        for where in np.ndindex(states.shape[:-1]):
            mujoco.mju_rotVecQuat(turned[where], centre, states[where][3:7])
        return states[..., :3] + turned

    steps = np.arange(1, 51)
    # semi-implicit Euler: position after k steps under a constant acceleration a is a dt^2 k (k + 1) / 2
    moved = 0.5 * 0.002**2 * steps * (steps + 1)
    np.testing.assert_allclose(
        centres(pushed) - centres(free), np.broadcast_to(moved[:, None] * force, (3, 50, 3)), atol=1e-9
    )


def test_external_force_is_xfrc_applied():
    """By hand in plain MuJoCo, on an arm."""
    force = [3.0, -2.0, 4.0]

    def push(model, data):
        data.xfrc_applied[model.body("hand").id, :3] = force

    same_as(make("external_force", "hand", **FORCE), force, SERVO_ARM, push)


@pytest.mark.parametrize(("roll", "pitch"), [(0.3, 0.0), (0.0, -0.2), (0.25, 0.4)])
def test_gravity_tilt_is_a_tilted_base(roll, pitch):
    """The joints of a robot on a base that was turned about x and then about the fixed y axis."""
    sim = make("gravity_tilt", roll=(-1, 1), pitch=(-1, 1))
    turned = np.empty(4)
    about_x = np.array([np.cos(roll / 2), np.sin(roll / 2), 0, 0])
    about_y = np.array([np.cos(pitch / 2), 0, np.sin(pitch / 2), 0])
    mujoco.mju_mulQuat(turned, about_y, about_x)
    quat = " ".join(map(repr, turned.tolist()))
    xml = replaced('<body name="upper" pos="0 0 2">', f'<body quat="{quat}"><body name="upper" pos="0 0 2">')
    xml = replaced("</worldbody>", "</body></worldbody>", xml)
    same_as(sim, [roll, pitch], xml)


def test_fluid_drag_adds_to_the_medium():
    """MJCF with the sum of both densities and viscosities."""
    sim = make("fluid_drag", None, AIRY, density=(0, 1000), viscosity=(0, 5))
    xml = SERVO_ARM.replace('timestep="0.002"', 'timestep="0.002" density="301.2" viscosity="0.500018"')
    same_as(sim, [300.0, 0.5], xml)


@pytest.mark.parametrize("xml", [AIRY, SERVO_ARM])
def test_wind_is_mujocos(xml):
    """MJCF with a wind, in the model's medium, or in air where it has none."""
    dense = 'density="1.2" viscosity="1.8e-5"' if xml is AIRY else 'density="1.2"'
    blown = SERVO_ARM.replace('timestep="0.002"', f'timestep="0.002" {dense} wind="4 -7 2"')
    same_as(make("wind", None, xml, **WIND), [4.0, -7.0, 2.0], blown)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_wind_and_drag_compose_in_any_order(order):
    """A denser medium than the model's own, or than the air that the wind puts where there is none."""
    chosen = [effect("wind", **WIND), effect("fluid_drag", density=(0, 1000), viscosity=(0, 5))]
    values = [[4.0, -7.0, 2.0], [0.1, 0.5]]
    for own, density, viscosity in (("", 1.3, 0.5), ('density="900" viscosity="0.2"', 900.1, 0.7)):
        xml = replaced('timestep="0.002"', f'timestep="0.002" {own}')
        sim = MujocoSimulator(load(xml), None, [chosen[i] for i in order])
        medium = f'density="{density}" viscosity="{viscosity}" wind="4 -7 2"'
        same_as(sim, [v for i in order for v in values[i]], replaced('timestep="0.002"', f'timestep="0.002" {medium}'))


def test_wind_carries_a_light_body_along():
    """A sphere without weight ends at the speed of the wind."""
    xml = """<mujoco><option gravity="0 0 0" density="1.2" timestep="0.01"/><worldbody><body name="ball"><freejoint/>
    <geom type="sphere" size="0.3" mass="0.02"/></body></worldbody></mujoco>"""
    sim = make("wind", None, xml, **WIND)
    windows = make_windows(sim.model, 1, 3000, speed=0.0)
    speed = predict(sim, [[3.0, 1.0, -2.0]], windows)[0, 0, -1, 7:10]
    np.testing.assert_allclose(speed, [3.0, 1.0, -2.0], rtol=0.05)


def test_payload_force_and_tilt_compose():
    """Three effects at once: plain MuJoCo with the ball, the pull and the turned gravity."""
    chosen = [
        effect("payload", "hand", mass=(0, 3), **PLACE),
        effect("external_force", "lower", **FORCE),
        effect("gravity_tilt", roll=(-1, 1), pitch=(-1, 1)),
    ]
    sim = MujocoSimulator(load(SERVO_ARM), None, chosen, check_influence=False)
    place, force, pitch = (0.05, 0.02, -0.1), (1.0, -2.0, 3.0), 0.2
    model = load_model(with_ball(SERVO_ARM, "hand", 0.4, place))
    model.opt.gravity[:] = 9.81 * np.sin(pitch), 0, -9.81 * np.cos(pitch)
    windows = make_windows(sim.model, 2, 10, nsub=4)
    predicted = predict(sim, [[0.4, *place, *force, 0.0, pitch]], windows)[0]

    def push(model, data):
        data.xfrc_applied[model.body("lower").id, :3] = force

    for n in range(2):
        expected = plain_rollout(model, windows.start[n], windows.ctrl[n], 4, push)
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-8)
