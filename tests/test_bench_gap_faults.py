"""The faults of the gap benchmark against what mechanics says of them."""

import mujoco
import numpy as np
import pytest

from nfpde.bench.gap.faults import bodies, commands, drives, friction, sensors, world
from nfpde.bench.gap.plant import Plant
from tests.gap_plants import CONTROL, DT, FLOOR, GEAR, HINGE, MASS, SERVO, SLIDER, moved


def test_coulomb_friction_slows_evenly_and_stops():
    """A cart slows by torque / mass, stops after v m / F, and stays."""
    seen = moved(SLIDER, friction.DryFriction("rail", {"torque": 3.0}), None, 120, qvel=1.0)
    assert seen[20, 1] == pytest.approx(1 - 3 / MASS * 0.2, abs=1e-9)  # exact in discrete time too
    stop = MASS / 3 / CONTROL
    assert np.all(np.abs(seen[int(stop) + 2 :, 1]) < 1e-12)
    assert seen[-1, 0] == pytest.approx(MASS / (2 * 3), abs=1.0 * DT)  # the last step is not a whole one


@pytest.mark.parametrize(("force", "rate"), [(2.9, 0.0), (-2.9, 0.0), (5.0, 1.0), (-5.0, -1.0)])
def test_coulomb_friction_holds_up_to_its_torque(force, rate):
    """Below it nothing moves; above it the rest accelerates."""
    seen = moved(SLIDER, friction.DryFriction("rail", {"torque": 3.0}), force / GEAR, 50)
    assert seen[-1, 1] == pytest.approx(rate * 0.5, abs=1e-9)


def test_friction_holds_a_servo_in_place():
    """With a servo's damping in the integrator, a held joint creeps by rounding errors only."""
    fault = friction.DryFriction("elbow", {"torque": 5.0})
    seen = moved(SERVO, fault, 0.05, 50)
    assert np.abs(seen[-1, 0]) < 1e-9  # 40 * 0.05 and gravity 0.5 * 9.81 * 0.3 stay below 5


def test_stribeck_friction_breaks_away_at_static_and_runs_at_coulomb():
    """Static friction decides about the start, Coulomb friction about fast motion."""
    values = {"coulomb": 1.0, "static": 2.0, "speed": 0.05}
    held = moved(SLIDER, friction.Stribeck("rail", values), 1.95 / GEAR, 50)
    gone = moved(SLIDER, friction.Stribeck("rail", values), 2.05 / GEAR, 50)
    fast = moved(SLIDER, friction.Stribeck("rail", values), None, 10, qvel=3.0)
    assert abs(held[-1, 0]) < 1e-12
    assert gone[-1, 0] > 1e-3
    assert fast[-1, 1] == pytest.approx(3 - 1.0 / MASS * 0.1, abs=1e-9)


def test_load_friction_grows_with_the_drive():
    """A share of the drive's force at the joint is lost, on top of a constant."""
    seen = moved(SLIDER, friction.LoadFriction("rail", {"base": 1.0, "share": 0.25}), 10 / GEAR, 50)
    assert seen[-1, 1] == pytest.approx((10 - 1 - 2.5) / MASS * 0.5, abs=1e-9)


@pytest.mark.parametrize("steps", [1, 7, 10, 23])
def test_a_delay_shifts_the_answer(steps):
    """The delayed cart does what the sound one does, so many physics steps later."""
    rng = np.random.default_rng(0)
    ctrl = rng.normal(size=(40, 1))
    ctrl[0] = 0
    fine = SLIDER
    late = Plant(fine, DT, faults=[commands.DeadTime("all", {"delay": steps * DT})])
    sound = Plant(fine, DT)
    traces = []
    for plant in (late, sound):
        plant.begin(np.zeros(1), np.zeros(1), ctrl[0])
        trace = []
        for u in np.repeat(ctrl, 10, 0):
            plant.advance(u)
            trace.append(plant.data.qpos[0])
        traces.append(np.array(trace))
    np.testing.assert_allclose(traces[0][steps:], traces[1][:-steps], atol=1e-15)


def test_late_readings_look_like_late_commands():
    """From rest and seen from outside, the two delays are one."""
    ctrl = np.sin(np.arange(60) / 5)[:, None]
    late = moved(SLIDER, commands.DeadTime("all", {"delay": 0.013}), ctrl, 60)
    old = moved(SLIDER, sensors.LateReading("all", {"delay": 0.013}), ctrl, 60)
    np.testing.assert_allclose(late, old, atol=1e-12)
    assert np.abs(late - moved(SLIDER, None, ctrl, 60)).max() > 1e-3


def test_a_lag_answers_a_step_exponentially():
    """After a step of the command the force is F (1 - exp(-t / T)), so v = F / m (t - T (1 - exp(-t / T)))."""
    time_constant, ctrl = 0.08, np.ones((60, 1))
    ctrl[0] = 0
    seen = moved(SLIDER, commands.Lag("motor", {"time_constant": time_constant}), ctrl, 60)
    t = 0.59
    expected = GEAR / MASS * (t - time_constant * (1 - np.exp(-t / time_constant)))
    assert seen[-1, 1] == pytest.approx(expected, rel=1e-4)  # trapezoids: (DT / 16 / T)**2 / 12


@pytest.mark.parametrize(("ctrl", "force"), [(0.3, 0.0), (-0.3, 0.0), (0.9, 0.5), (-0.9, -0.5)])
def test_a_dead_zone_takes_its_width_off(ctrl, force):
    """Within it nothing, outside it the rest of the command."""
    seen = moved(SLIDER, commands.DeadZone("motor", {"half_width": 0.4}), ctrl, 10)
    assert seen[-1, 1] == pytest.approx(GEAR * force / MASS * 0.1, abs=1e-12)


def test_a_bias_adds_to_the_command():
    """A cart without command accelerates by gear times offset over mass."""
    seen = moved(SLIDER, commands.Bias("motor", {"offset": -0.2}), None, 10)
    assert seen[-1, 1] == pytest.approx(-0.2 * GEAR / MASS * 0.1, abs=1e-12)


def test_a_weak_motor_scales_its_force():
    """Acceleration in proportion."""
    seen = moved(SLIDER, drives.Strength("motor", {"scale": 0.8}), 1.0, 10)
    assert seen[-1, 1] == pytest.approx(0.8 * GEAR / MASS * 0.1, abs=1e-12)


def test_servo_gains_decide_about_the_droop():
    """At rest kp (u - q) balances gravity m g r cos q."""
    seen = moved(SERVO, drives.ServoGain("servo", {"kp_scale": 0.7, "kv_scale": 1.5}), 0.0, 400)
    q = seen[-1, 0]
    assert 0.7 * 40 * (0 - q) == pytest.approx(-0.5 * 9.81 * 0.3 * np.cos(q), rel=1e-6)


def test_a_torque_limit_is_felt_at_the_joint():
    """Behind a gear of 3 the limit is still in newtons at the rail."""
    seen = moved(SLIDER, drives.TorqueLimit("motor", {"limit": 5.0}), 10.0, 10)
    assert seen[-1, 1] == pytest.approx(5.0 / MASS * 0.1, abs=1e-12)


def test_a_motor_curve_ends_at_the_no_load_speed():
    """At full command m v' = S (1 - v / v0), so v = v0 (1 - exp(-S t / (m v0)))."""
    fault = drives.TorqueSpeed("motor", {"no_load_speed": 1.5, "stall_torque": 12.0})
    seen = moved(SLIDER, fault, 50.0, 40)
    expected = 1.5 * (1 - np.exp(-12 * 0.4 / (MASS * 1.5)))
    assert seen[-1, 1] == pytest.approx(expected, rel=6 * DT)  # explicit steps of DT, time constant 0.25 s
    braking = moved(SLIDER, drives.TorqueSpeed("motor", dict(fault.values)), -50.0, 5, qvel=1.0)
    assert braking[-1, 1] == pytest.approx(1.0 - 12 / MASS * 0.05, abs=1e-9)


def test_play_opens_a_hysteresis_of_its_width():
    """Turned slowly one way and back, without gravity, the joint differs by the play at equal commands."""
    xml = SERVO.replace("<option", '<option gravity="0 0 0"')
    ramp = np.concatenate([np.linspace(-1, 1, 600), np.linspace(1, -1, 600)])[:, None]
    there = {}
    for name, fault in (("play", drives.GearPlay("servo", {"width": 0.06})), ("sound", None)):
        seen = moved(xml, fault, ramp, 1200, qpos=-1.0)[1:, 0]
        there[name] = seen[899] - seen[300]  # the command is 0 at both, once downwards and once upwards
    assert there["play"] - there["sound"] == pytest.approx(0.06, rel=0.1)  # the teeth give by the damping's torque


def test_play_lets_the_rotor_run_before_the_joint_moves():
    """Half the play passes in sqrt(w J / torque) before the first push."""
    xml, width, torque = HINGE.replace("<option", '<option gravity="0 0 0"'), 0.1, 0.5
    plant = Plant(xml, DT, faults=[drives.GearPlay("motor", {"width": width})])
    plant.begin(np.zeros(1), np.zeros(1), np.zeros(1))
    steps = 0
    while plant.data.qvel[0] == 0 and steps < 1000:
        plant.advance(np.array([torque]))
        steps += 1
    assert steps * DT == pytest.approx(np.sqrt(width * 0.9 * 0.02 / torque), abs=2 * DT)


def test_grease_slows_exponentially():
    """The speed falls as exp(-d t / m)."""
    seen = moved(SLIDER, bodies.Grease("rail", {"damping": 4.0}), None, 50, qvel=1.0)
    assert seen[-1, 1] == pytest.approx(np.exp(-4 / MASS * 0.5), rel=2 * 4 / MASS * DT)  # implicit Euler


def test_a_spring_swings_at_its_frequency():
    """A cart on a spring is back after 2 pi sqrt(m / k)."""
    stiffness = MASS * (2 * np.pi / 0.5) ** 2
    seen = moved(SLIDER, bodies.Spring("rail", {"stiffness": stiffness, "rest": 0.1}), None, 50)
    assert seen[25, 0] == pytest.approx(0.2, abs=1e-3)
    assert seen[50, 0] == pytest.approx(0.0, abs=1e-3)


def test_a_rotor_adds_to_the_mass():
    """The acceleration is F / (m + J)."""
    seen = moved(SLIDER, bodies.RotorInertia("rail", {"inertia": 1.0}), 1.0, 10)
    assert seen[-1, 1] == pytest.approx(GEAR / (MASS + 1) * 0.1, abs=1e-12)


def inertia_and_torque(fault):
    """Mass matrix and gravity torque of the horizontal arm."""
    plant = Plant(HINGE, CONTROL, faults=[fault] if fault else [])
    plant.begin(np.zeros(1), np.zeros(1), np.zeros(1))
    mass = np.zeros((1, 1))
    mujoco.mj_fullM(plant.model, plant.data, mass)
    return mass[0, 0], plant.data.qfrc_bias[0]


def test_a_payload_pulls_by_its_weight_at_its_place():
    """Torque m g x and inertia m (x^2 + z^2) + 2/5 m r^2 about the horizontal arm's joint."""
    fault = bodies.Payload("arm", {"mass": 0.4, "position": [0.25, 0.1, -0.05]})
    (inertia, torque), (inertia0, torque0) = inertia_and_torque(fault), inertia_and_torque(None)
    assert abs(torque - torque0) == pytest.approx(0.4 * 9.81 * 0.25, rel=1e-9)
    own = 0.4 * 0.4 * bodies.Payload.RADIUS**2
    assert inertia - inertia0 == pytest.approx(0.4 * (0.25**2 + 0.05**2) + own, rel=1e-9)


def test_a_moved_mass_pulls_elsewhere():
    """Torque m g (r + s), inertia by Steiner."""
    fault = bodies.MassMoved("arm", {"shift": [0.04, 0.0, 0.0]})
    (inertia, torque), (inertia0, torque0) = inertia_and_torque(fault), inertia_and_torque(None)
    assert abs(torque - torque0) == pytest.approx(0.5 * 9.81 * 0.04, rel=1e-9)
    assert inertia - inertia0 == pytest.approx(0.5 * (0.34**2 - 0.3**2), rel=1e-9)


def test_a_steady_force_accelerates():
    """The acceleration is F_x / m; the other axes are held by the rail."""
    seen = moved(SLIDER, bodies.SteadyForce("cart", {"force": [1.5, -7.0, 3.0]}), None, 10)
    assert seen[-1, 1] == pytest.approx(1.5 / MASS * 0.1, abs=1e-12)


@pytest.mark.parametrize(("roll", "pitch", "axis", "expected"), [(0, 0.1, "1 0 0", 1), (0.1, 0, "0 1 0", -1)])
def test_a_tilted_mount_turns_gravity(roll, pitch, axis, expected):
    """Pitched forward, x points downhill; rolled to the right, y points uphill: g sin of the angle."""
    xml = SLIDER.replace('axis="1 0 0"', f'axis="{axis}"')
    seen = moved(xml, world.Tilt("world", {"roll": roll, "pitch": pitch}), None, 10)
    assert seen[-1, 1] == pytest.approx(expected * 9.81 * np.sin(0.1) * 0.1, rel=1e-9)


def test_drag_in_a_denser_fluid_grows_with_the_square_of_the_speed():
    """Four times the loss at twice the speed, where viscosity does nothing."""
    loss = []
    for speed in (1.0, 2.0):
        seen = moved(SLIDER, world.Fluid("world", {"density": 50.0, "viscosity": 0.0}), None, 1, qvel=speed)
        loss.append(speed - seen[-1, 1])
    assert loss[1] / loss[0] == pytest.approx(4, rel=0.02)  # the speed falls a little within the step


def test_wind_pushes_like_motion_through_still_air():
    """A cart at rest in wind gains what one that moves against still air loses."""
    xml = SLIDER.replace("<option", '<option density="30"')
    blown = moved(xml, world.Wind("world", {"velocity": [2.0, 0, 0]}), None, 1)
    driven = moved(xml, None, None, 1, qvel=-2.0)
    assert blown[-1, 1] == pytest.approx(driven[-1, 1] + 2.0, abs=1e-9)


def slide(fault):
    """Speed of the block on the floor after 0.3 s from 2 m/s."""
    plant = Plant(FLOOR, CONTROL, faults=[fault] if fault else [])
    plant.begin(np.zeros(2), np.array([2.0, 0.0]), np.zeros(0))
    for _ in range(30):
        plant.advance(np.zeros(0))
    return plant.data.qvel[0]


@pytest.mark.parametrize("coefficient", [0.2, 0.8])
def test_ground_friction_slows_by_its_coefficient(coefficient):
    """The speed is v0 - mu g t, for less friction than the model's and for more."""
    left = slide(world.Slippery("contact", {"friction": coefficient}))
    assert left == pytest.approx(max(2 - coefficient * 9.81 * 0.3, 0), abs=0.02)  # first contact takes a few steps


def lowest(fault, height=0.05):
    """Lowest and last position of a block that falls from a height."""
    plant = Plant(FLOOR, CONTROL, faults=[fault] if fault else [])
    plant.begin(np.array([0.0, height]), np.zeros(2), np.zeros(0))
    seen = []
    for _ in range(150):
        plant.advance(np.zeros(0))
        seen.append(plant.data.qpos[1])
    return min(seen), seen[-1]


def test_a_raised_ground_holds_the_block_higher():
    """At rest it stands higher by the height."""
    assert lowest(world.Raised("contact", {"height": 0.02}))[1] - lowest(None)[1] == pytest.approx(0.02, abs=1e-6)


def test_a_soft_ground_gives_way():
    """With a time constant four times as long the block sinks in deeper, about four times (v t)."""
    depth = [-lowest(f)[0] for f in (None, world.Soft("contact", {"time_constant": 0.04, "damping_ratio": 1.0}))]
    assert depth[1] / depth[0] == pytest.approx(4, rel=0.4)  # control steps of 10 ms miss the very lowest point


def test_an_encoder_zero_shows_in_the_reading_and_moves_the_servo():
    """A servo without load brings its reading, not its angle, to the command."""
    plant = Plant(SERVO.replace("<option", '<option gravity="0 0 0"'), CONTROL)
    faulty = Plant(
        SERVO.replace("<option", '<option gravity="0 0 0"'),
        CONTROL,
        faults=[sensors.EncoderZero("elbow", {"offset": 0.1})],
    )
    for each in (plant, faulty):
        each.begin(np.zeros(1), np.zeros(1), np.array([0.3]))
        for _ in range(300):
            each.advance(np.array([0.3]))
    assert faulty.reading()[0][0] == pytest.approx(0.3, abs=1e-6)
    assert faulty.data.qpos[0] == pytest.approx(0.2, abs=1e-6)
    assert plant.data.qpos[0] == pytest.approx(0.3, abs=1e-6)


def test_an_encoder_scale_stretches_angle_and_speed():
    """Both readings are multiplied, the cart itself moves as before."""
    seen = moved(SLIDER, sensors.EncoderScale("rail", {"scale": 1.1}), 1.0, 10)
    np.testing.assert_allclose(seen, 1.1 * moved(SLIDER, None, 1.0, 10), rtol=1e-12)


def test_a_wrong_clock_lets_more_time_pass():
    """A cart at 1 m/s is further by the ratio; its speed is the true one."""
    seen = moved(SLIDER, sensors.WrongClock("all", {"ratio": 1.05}), None, 100, qvel=1.0)
    assert seen[-1].tolist() == pytest.approx([1.05, 1.0], abs=1e-9)


def test_readings_of_the_encoder_leave_the_servo_alone():
    """The robot moves as without a fault; the log shows the angle shifted or scaled, speeds scaled or right."""
    zero = Plant(SERVO, DT, faults=[sensors.LoggedZero("elbow", {"offset": 0.2})])
    both = Plant(SERVO, DT, faults=[sensors.LoggedScale("elbow", {"scale": 1.3})])
    angle = Plant(SERVO, DT, faults=[sensors.LoggedPositionScale("elbow", {"scale": 1.3})])
    clock = Plant(SERVO, DT, faults=[sensors.CountingClock("all", {"ratio": 1.1})])
    sound, slow = Plant(SERVO, DT), Plant(SERVO, DT, faults=[sensors.WrongClock("all", {"ratio": 1.1})])
    qpos, qvel = np.array([0.1]), np.array([0.3])
    for plant in (zero, both, angle, clock, sound, slow):
        plant.begin(qpos, qvel, np.array([0.4]))
        for _ in range(20):
            plant.advance(np.array([0.4]))
    q, v = sound.data.qpos[0], sound.data.qvel[0]

    def shown(plant):
        found = plant.faults[0].observe(plant, plant.data.qpos, plant.data.qvel)
        return found[0][0], found[1][0]

    assert shown(zero) == pytest.approx((q + 0.2, v), abs=1e-12)
    assert shown(both) == pytest.approx((1.3 * q, 1.3 * v), abs=1e-12)
    assert shown(angle) == pytest.approx((1.3 * q, v), abs=1e-12)
    assert shown(clock) == pytest.approx((slow.data.qpos[0], 1.1 * slow.data.qvel[0]), abs=1e-12)


def test_a_gate_passes_what_is_large_as_it_is():
    """Within the zone the cart stays; beyond it the whole force acts."""
    small = moved(SLIDER, commands.Gate("motor", {"half_width": 0.3}), 0.29, 30)
    large = moved(SLIDER, commands.Gate("motor", {"half_width": 0.3}), 0.31, 30)
    assert np.abs(small).max() == 0
    assert large[-1, 1] == pytest.approx(0.31 * GEAR / MASS * 0.3, abs=1e-9)


def test_a_servo_that_aims_short_comes_to_a_share_of_its_command():
    """Without gravity it rests at scale times the command; a weak one at the command."""
    xml = SERVO.replace("<option", '<option gravity="0 0 0"', 1)
    assert "gravity" in xml
    short = moved(xml, drives.AimedShort("servo", {"scale": 0.8}), 0.5, 400)
    weak = moved(xml, drives.Strength("servo", {"scale": 0.8}), 0.5, 400)
    assert short[-1, 0] == pytest.approx(0.4, abs=1e-6)
    assert weak[-1, 0] == pytest.approx(0.5, abs=1e-6)
