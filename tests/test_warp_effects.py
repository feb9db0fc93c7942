"""Kernels of effects on Warp's CPU device, each against its numpy form in MujocoSimulator."""

import pkgutil

import numpy as np
import pytest
import warp as wp

import nfpde.kernels
from nfpde.benchmarks import ROBOTS
from nfpde.effects import Effect, Quantity, effect, effect_names
from nfpde.effects.registry import all_candidates
from nfpde.effects.scales import DataScales
from nfpde.errors import BadEffect
from nfpde.sim import load_model
from nfpde.sim.acting import effect_columns
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.warp_device import start_warp
from nfpde.sim.warp_effects import COMMANDS, SENSORS, STEPS
from tests.device import WARP
from tests.models import DOUBLE_PENDULUM, load, make_windows, record, with_arrays

# Positions and velocities of a few units after 20 physics steps in single precision, friction switching on the way
TOLERANCE = 5e-5

CASES = {
    "actuation_delay": ("*", {"delay": (0.0, 0.03)}),
    "actuator_bias": ("elbow_motor", {"offset": (-1.0, 1.0)}),
    "actuator_lag": ("*", {"time_constant": (0.0, 0.02)}),
    "backlash": ("*", {"width": (0.0, 0.1)}),
    "backlash_geared": ("*", {"width": (0.0, 0.1)}),
    "backlash_geared_outer": ("*", {"width": (0.0, 0.1)}),
    "backlash_outer": ("*", {"width": (0.0, 0.1)}),
    "dead_zone": ("*", {"half_width": (0.0, 0.5)}),
    "dead_zone_gate": ("*", {"half_width": (0.0, 0.5)}),
    "external_force": ("lower", {"force_x": (-5, 5), "force_y": (-5, 5), "force_z": (-5, 5)}),
    "joint_offset": ("shoulder", {"offset": (-0.5, 0.5)}),
    "joint_offset_logged": ("shoulder", {"offset": (-0.5, 0.5)}),
    "joint_spring": ("*", {"stiffness": (0.0, 3.0), "rest": (-1.0, 1.0)}),
    "load_friction": ("*", {"base": (0.0, 0.3), "share": (0.0, 0.9)}),
    "observation_delay": (None, {"delay": (0.0, 0.03)}),
    "sensor_scale": ("*", {"scale": (0.6, 1.7)}),
    "sensor_scale_logged": ("*", {"scale": (0.6, 1.7)}),
    "sensor_scale_position": ("*", {"scale": (0.6, 1.7)}),
    "stribeck_friction": ("*", {"coulomb": (0.0, 0.5), "static": (0.0, 1.0), "speed": (0.05, 0.5)}),
    "time_scale_counted": (None, {"ratio": (0.8, 1.25)}),
    "torque_speed": ("*", {"no_load_speed": (0.5, 5.0), "stall_torque": (0.2, 3.0)}),
}


def arm(*effects, **options):
    return WarpSimulator(load(DOUBLE_PENDULUM), None, effects, device=WARP, check_influence=False, **options)


def neutral(sim):
    """The box's point nearest to where the effects do nothing."""
    values = np.array([q.neutral for e in sim.effects for q in e.quantities])
    return np.clip(values, sim.space.low, sim.space.high)


@pytest.mark.parametrize("name", CASES)
def test_kernel_equals_its_twin(name):
    """Random parameters, neutral ones, and bounds: predictions of windows with a history of commands."""
    target, bounds = CASES[name]
    sim = arm(effect(name, target, **bounds))
    windows = make_windows(sim.model, 4, 5, nsub=4, history=28)
    xi = np.vstack([sim.space.uniform(4, np.random.default_rng(0)), sim.space.low, sim.space.high, neutral(sim)])
    expected = sim.reference.predict(xi, windows)
    # the effect shows: a kernel that does nothing would not pass
    assert np.abs(expected[:4] - expected[-1]).max() > 100 * TOLERANCE
    np.testing.assert_allclose(sim.predict(xi, windows), expected, atol=TOLERANCE)


SERVOS = DOUBLE_PENDULUM.replace(
    '<motor joint="shoulder" gear="3"/>',
    '<position joint="shoulder" gear="2" kp="20" kv="1" ctrlrange="-0.5 0.5" forcerange="-3 3"/>',
).replace(
    '<motor name="elbow_motor" joint="elbow"/>', '<velocity name="elbow_motor" joint="elbow" kv="3" ctrlrange="-1 1"/>'
)


def equals_its_twin(sim, more=0):
    """Predictions all over the bounds, and at their ends, are those of plain MuJoCo, and differ from each other.

    Windows hold `more` commands than must be known.
    """
    windows = make_windows(sim.model, 4, 5, nsub=4, history=more + sim.history_steps(4 * sim.model.opt.timestep))
    xi = np.vstack([sim.space.uniform(4, np.random.default_rng(0)), sim.space.low, sim.space.high])
    expected = sim.reference.predict(xi, windows)
    assert np.ptp(expected, axis=0).max() > 100 * TOLERANCE
    np.testing.assert_allclose(sim.predict(xi, windows), expected, atol=TOLERANCE)


@pytest.mark.parametrize(
    "name",
    [
        "backlash",
        "backlash_geared",
        "backlash_geared_outer",
        "backlash_outer",
        "dead_zone",
        "dead_zone_gate",
        "joint_offset",
        "joint_offset_logged",
        "load_friction",
        "sensor_scale",
        "sensor_scale_logged",
        "torque_speed",
    ],
)
def test_kernel_equals_its_twin_with_servos(name):
    """Position and velocity servos with gears and limits, where the effects act in other ways than with motors."""
    bounds = CASES[name][1]
    sim = WarpSimulator(load(SERVOS), None, [effect(name, "*", **bounds)], device=WARP, check_influence=False)
    equals_its_twin(sim)


@pytest.mark.parametrize("more", [0, 30])
def test_play_of_a_servos_command_equals_its_twin(more):
    """It needs a position servo; its gear is 2. Of more commands that are known, both go through all."""
    play = effect("backlash_command", "#0", width=(0.0, 0.3))
    equals_its_twin(WarpSimulator(load(SERVOS), None, [play], device=WARP, check_influence=False), more)


def test_dead_zones_are_about_what_encoders_read():
    """The error of a servo counts its reading: off by an offset, and a multiple of the motion."""
    effects = [effect(name, "shoulder", **CASES[name][1]) for name in ("joint_offset", "sensor_scale")]
    zone = effect("dead_zone", "#0", half_width=(0.0, 0.5))
    sim = WarpSimulator(load(SERVOS), None, [zone, *effects], device=WARP, check_influence=False)
    equals_its_twin(sim)


def test_a_clock_that_is_a_little_off_changes_nothing():
    """A control step of 0.05 % more is simulated as that of an exact clock, before the window too, bit by bit."""
    sim = arm(effect("actuation_delay", "*", delay=(0.0, 0.008)), effect("backlash", "*", width=(0.0, 0.1)))
    data = record(sim.model, 1, 40, 4)
    dt = data.control_dt
    windows = data.windows(3, history=sim.history_steps(dt), past=sim.past_steps(dt))
    drifting = with_arrays(windows, control_dt=1.0005 * dt)
    xi = [[0.005, 0.05]]
    np.testing.assert_array_equal(sim.predict(xi, drifting), sim.predict(xi, windows))


@pytest.mark.parametrize("xml", [DOUBLE_PENDULUM, SERVOS], ids=["motors", "servos"])
def test_rotors_are_moved_by_the_time_steps_of_their_rows(xml):
    """Backlash beside a clock that runs wrong, in every row by its own ratio."""
    effects = [effect("backlash", "*", width=(0.0, 0.1)), effect("time_scale", ratio=(0.8, 1.25))]
    equals_its_twin(WarpSimulator(load(xml), None, effects, device=WARP, check_influence=False))


@pytest.mark.parametrize("xml", [DOUBLE_PENDULUM, SERVOS], ids=["motors", "servos"])
def test_rotors_are_where_the_recording_took_them(xml):
    """Backlash, behind late commands and beside an encoder that is off, through the recorded motion before windows."""
    model = load(xml)
    effects = [
        effect("actuation_delay", "elbow_motor", delay=(0.0, 0.004)),
        effect("backlash", "*", width=(0.0, 0.1)),
        effect("joint_offset", "elbow", offset=(-0.2, 0.2)),
    ]
    sim = WarpSimulator(model, None, effects, device=WARP, check_influence=False)
    data = record(model, 2, 120, 4, amplitude=1.0)
    dt = data.control_dt
    windows = data.windows(5, stride=11, history=sim.history_steps(dt), past=sim.past_steps(dt))
    assert np.isnan(windows.past).any()
    assert np.isfinite(windows.past).all((1, 2)).any()
    xi = np.vstack([sim.space.uniform(4, np.random.default_rng(0)), neutral(sim)])
    expected = sim.reference.predict(xi, windows)
    blind = sim.reference.predict(xi, with_arrays(windows, past=windows.past[:, :0]))
    assert np.abs(expected - blind)[:4].max() > 100 * TOLERANCE
    np.testing.assert_array_equal(expected[4], blind[4])
    # a tooth that meets one step later in float32 moves the joint by more than rounding does
    apart = np.abs(sim.predict(xi, windows) - expected).max((2, 3))
    assert np.median(apart) < TOLERANCE
    assert (apart < 100 * TOLERANCE).mean() > 0.9


@pytest.mark.parametrize(
    ("name", "bounds", "weak"),
    [
        ("torque_limit", {"limit": (0.1, 1e12)}, [0.3]),
        ("torque_speed", {"no_load_speed": (0.1, 1e12), "stall_torque": (0.1, 1e12)}, [2.0, 0.3]),
    ],
)
def test_limits_that_only_some_rows_have(name, bounds, weak):
    """All worlds share whether a joint's force is limited; rows without the effect get a range that nothing reaches."""
    sim = arm(effect(name, "*", **bounds))
    windows = make_windows(sim.model, 4, 5, nsub=4)
    xi = np.array([[1e12] * len(weak), weak])
    expected = sim.reference.predict(xi, windows)
    assert np.abs(expected[1] - expected[0]).max() > 100 * TOLERANCE
    np.testing.assert_allclose(sim.predict(xi, windows), expected, atol=TOLERANCE)


def test_every_kernel_has_a_case():
    """A kernel that nobody compares with its twin is not offered."""
    # no effect of the library, but of the diagnosis, beside which it is tested; and one of position servos alone
    ours = {"residual_force", "backlash_command"}
    assert CASES.keys() | ours == COMMANDS.keys() | STEPS.keys() | SENSORS.keys()
    assert CASES.keys() <= set(effect_names())


def test_effects_together():
    """All of them in one simulator, in series where they meet, with parameters that switch some off in some rows."""
    sim = arm(*(effect(name, target, **bounds) for name, (target, bounds) in CASES.items()))
    windows = make_windows(sim.model, 3, 4, nsub=3, history=40)
    xi = sim.space.uniform(6, np.random.default_rng(1))
    off = np.random.default_rng(2).random(xi.shape) < 0.4
    xi = np.clip(np.where(off, neutral(sim), xi), sim.space.low, sim.space.high)
    np.testing.assert_allclose(sim.predict(xi, windows), sim.reference.predict(xi, windows), atol=TOLERANCE)
    scale = np.ones(4)
    np.testing.assert_allclose(sim.losses(xi, windows, scale), sim.reference.losses(xi, windows, scale), rtol=1e-3)


def test_delay_of_whole_and_broken_steps():
    """A delay of k steps is a plain shift although k times the step is no float; between, commands are averaged."""
    sim = arm(effect("actuation_delay", "*", delay=(0.0, 0.1)))
    windows = make_windows(sim.model, 3, 6, history=60)
    xi = sim.model.opt.timestep * np.array([[0.0], [1.0], [2.5], [3.0]])
    np.testing.assert_allclose(sim.predict(xi, windows), sim.reference.predict(xi, windows), atol=TOLERANCE)


def test_an_effect_without_a_kernel_is_named():
    """What has no kernel is refused when the simulator is made, with what to do."""

    class Unheard(Effect):
        name = "unheard_of"
        kind = "joint"
        quantities = (Quantity("size", "Nm", 0.0, 1.0, neutral=0.0),)
        sentence = ""

        def step(self, world, rows, values):
            world.qfrc_applied[rows] += values

    with pytest.raises(BadEffect, match=r"unheard_of has no kernel for MuJoCo Warp \(step\); use device='cpu'"):
        arm(Unheard("elbow", size=(0.0, 1.0)))


MODEL_CASES = {
    "armature": ("*", {"inertia": (0.0, 0.2)}),
    "gravity_tilt": (None, {"roll": (-0.3, 0.3), "pitch": (-0.3, 0.3)}),
    "time_scale": (None, {}),
    "fluid_drag": (None, {"density": (0.0, 500.0), "viscosity": (0.0, 5.0)}),
    "wind": (None, {"velocity_x": (-30, 30), "velocity_y": (-30, 30), "velocity_z": (-30, 30)}),
}


@pytest.mark.parametrize("name", MODEL_CASES)
def test_effects_on_options_and_fields(name):
    """What only changes the model, options that all worlds usually share among it, needs no kernel."""
    target, bounds = MODEL_CASES[name]
    sim = arm(effect(name, target, **bounds))
    windows = make_windows(sim.model, 3, 4, nsub=4, speed=3.0)
    xi = np.vstack([sim.space.uniform(3, np.random.default_rng(0)), sim.space.low, sim.space.high, neutral(sim)])
    expected = sim.reference.predict(xi, windows)
    assert np.abs(expected[:3] - expected[-1]).max() > 20 * TOLERANCE
    np.testing.assert_allclose(sim.predict(xi, windows), expected, atol=TOLERANCE)


def test_all_that_a_diagnosis_tries_on_a_robot_in_contact():
    """Of every effect that only changes the model, one as a diagnosis would try it on a falling Hopper, alone."""
    model = load_model(ROBOTS["hopper"].path)
    data = record(model, 1, 40, 4, seed=1)
    tried = {e.name: e for e in all_candidates(model, DataScales.of(model, data))}
    names = sorted(tried.keys() - COMMANDS.keys() - STEPS.keys() - SENSORS.keys() - MODEL_CASES.keys())
    assert len(names) > 5
    windows = data.windows(1, stride=5)
    sim = WarpSimulator(model, None, [tried[n] for n in names], device=WARP, check_influence=False)
    alone = np.repeat([neutral(sim)], len(names), axis=0)
    for row, columns in zip(alone, effect_columns(sim.effects, 0), strict=True):
        row[columns] = sim.space.uniform(1, np.random.default_rng(0))[0, columns]
    expected = sim.reference.predict(alone, windows)
    assert len(np.unique(expected[:, :, 0, -1], axis=0)) == len(names)
    square = ((sim.predict(alone, windows) - expected) ** 2).sum((2, 3)).max(1)
    # as for the robots themselves, see test_warp
    assert dict(zip(names, square < 1e-6, strict=True)) == dict.fromkeys(names, True)


@pytest.mark.parametrize("module", [m.name for m in pkgutil.iter_modules(nfpde.kernels.__path__)])
def test_kernels_compile_for_a_gpu(module, tmp_path):
    """NVRTC needs no GPU: every kernel becomes a cubin of compute capability 9.0."""
    start_warp()
    wp.compile_aot_module(f"nfpde.kernels.{module}", device=None, arch=90, module_dir=tmp_path)
    assert [f for f in tmp_path.iterdir() if f.suffix == ".cubin" and f.stat().st_size > 1000]
