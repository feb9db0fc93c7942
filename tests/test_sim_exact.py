"""MujocoSimulator against a plain loop over mj_step, bit for bit."""

import copy
import tracemalloc
from dataclasses import replace
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset
from nfpde.effects import effect
from nfpde.errors import BadInput, BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator, load_model, simulator, squared_error
from tests.models import (
    DOUBLE_PENDULUM,
    FREE_BOX,
    PENDULUM,
    load,
    make_windows,
    parameterised,
    plain_rollout,
    record,
    with_arrays,
)

ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
FILES = {"hopper": ("hopper.xml", 4), "walker2d": ("walker2d_v5.xml", 4)}
FILES |= {"half_cheetah": ("half_cheetah.xml", 5), "humanoid": ("humanoid.xml", 5)}


def robot(name):
    file, nsub = FILES[name]
    model = load_model(ASSETS / file)
    names = [model.body(i).name for i in range(1, model.nbody)]
    damped = [model.joint(int(model.dof_jntid[d])).name for d in range(model.nv) if model.dof_damping[d]]
    space = ParameterSpace(
        [
            *(Parameter("body_mass", n, 0.5, 1.5, relative=True) for n in names),
            *(Parameter("dof_damping", n, 0.5, 1.5, relative=True) for n in damped),
            Parameter("geom_friction", "*", 0.3, 1.5),
            Parameter("opt.gravity", None, -11.0, -9.0, component=2),
        ]
    )
    return model, space, nsub


def arm(**options):
    space = ParameterSpace(
        [
            Parameter("body_mass", "lower", 0.3, 1.5),
            Parameter("dof_damping", "shoulder", 0.0, 1.0),
            Parameter("dof_frictionloss", "elbow", 0.0, 0.3),
        ]
    )
    return MujocoSimulator(load(DOUBLE_PENDULUM), space, check_influence=False, **options)


@pytest.mark.parametrize("horizon", [1, 5])
@pytest.mark.parametrize("name", FILES)
def test_equals_a_plain_loop(name, horizon):
    """Gymnasium's robots, airborne and in contact: the same bits as a fresh model, mj_setConst and mj_step."""
    model, space, nsub = robot(name)
    sim = MujocoSimulator(model, space, check_influence=False)
    rng = np.random.default_rng(1)
    xi = space.uniform(3, rng)
    recorded = record(model, 2, 30, nsub, seed=2).windows(horizon, stride=7)
    wild = make_windows(model, 4, horizon, nsub=nsub, seed=3, spread=0.1)
    for windows in (recorded, wild):
        predicted = sim.predict(xi, windows)
        for i, vector in enumerate(xi):
            changed = copy.copy(model)
            for p, value in zip(space, vector, strict=True):
                write_plainly(changed, model, p, value)
            mujoco.mj_setConst(changed, mujoco.MjData(changed))
            for n in range(len(windows)):
                expected = plain_rollout(changed, windows.start[n], windows.ctrl[n], nsub)
                np.testing.assert_array_equal(predicted[i, n], expected)


def write_plainly(changed, nominal, p, value):
    """What each kind of parameter of `robot` means, in the words of MuJoCo's named access."""
    if p.field == "body_mass":
        changed.body(p.target).mass = nominal.body(p.target).mass * value
        changed.body(p.target).inertia = nominal.body(p.target).inertia * value
    elif p.field == "dof_damping":
        changed.joint(p.target).damping = nominal.joint(p.target).damping * value
    elif p.field == "geom_friction":
        changed.geom_friction[:, 0] = value
    else:
        changed.opt.gravity[p.component] = value


def test_humanoid_runs_on_newton():
    """Its file asks for PGS, which the GPU simulator does not have."""
    raw = mujoco.MjModel.from_xml_path(str(ASSETS / "humanoid.xml"))
    assert raw.opt.solver == mujoco.mjtSolver.mjSOL_PGS
    assert robot("humanoid")[0].opt.solver == mujoco.mjtSolver.mjSOL_NEWTON


@pytest.mark.parametrize("name", FILES)
def test_recorded_data_reproduce(name):
    """At the recorded parameters the prediction is the recording: the warm start it lacks costs rounding only."""
    model, space, nsub = robot(name)
    nominal = np.array([[1.0 if p.relative else np.nan for p in space]])
    nominal[0, -1] = model.opt.gravity[2]
    # one friction for all geoms is not the nominal model's: record from the model that the simulator builds
    nominal[0, -2] = 0.9
    sim = MujocoSimulator(model, space, check_influence=False)
    windows = record(parameterised(model, space, nominal[0]), 3, 30, nsub, seed=4).transitions()
    losses = sim.losses(nominal, windows, np.ones(sim.states.ndiff))
    assert losses.shape == (1, 90)
    # squared rounding: measured warm starts change velocities by up to 5e-13 (5e-7 for a humanoid in contact)
    assert losses.max() < (1e-9 if name == "humanoid" else 1e-20)
    off = space.low * 0.3 + space.high * 0.7
    assert np.median(sim.losses(off, windows, np.ones(sim.states.ndiff))) > 1e-4


def test_losses_are_those_of_predict():
    """(difference / scale)^2 summed over steps and channels, by hand."""
    sim = arm()
    windows = make_windows(sim.model, 7, 3)
    xi = sim.space.uniform(4, np.random.default_rng(0))
    scale = np.array([0.1, 0.2, 3.0, 4.0])
    by_hand = (((sim.predict(xi, windows) - windows.target) / scale) ** 2).sum((2, 3))
    np.testing.assert_allclose(sim.losses(xi, windows, scale), by_hand, rtol=1e-13)


def test_a_single_vector_and_no_window():
    """One vector may be given flat; no window gives no loss."""
    sim = arm()
    windows = make_windows(sim.model, 3, 2)
    flat = sim.predict(sim.space.low, windows)
    np.testing.assert_array_equal(flat, sim.predict(sim.space.low[None], windows))
    assert flat.shape == (1, 3, 2, 4)
    assert sim.losses(sim.space.low, windows[:0], np.ones(4)).shape == (1, 0)


@pytest.mark.parametrize(("rows", "numbers"), [(1, 10**9), (7, 10**9), (4096, 50), (4096, 1)])
def test_chunks_do_not_matter(monkeypatch, rows, numbers):
    """However many rows run side by side, and in however many groups, the bits are the same."""
    windows = make_windows(load(DOUBLE_PENDULUM), 9, 4, nsub=3)
    xi = arm().space.uniform(5, np.random.default_rng(0))
    whole = arm().predict(xi, windows)
    loss = arm().losses(xi, windows, np.ones(4))
    monkeypatch.setattr(simulator, "CHUNK_ROWS", rows)
    monkeypatch.setattr(simulator, "CHUNK_NUMBERS", numbers)
    np.testing.assert_array_equal(arm().predict(xi, windows), whole)
    np.testing.assert_array_equal(arm().losses(xi, windows, np.ones(4)), loss)


def test_threads_do_not_matter():
    """One thread or five, the bits are the same, also in the chaos of contacts."""
    model, space, nsub = robot("half_cheetah")
    windows = record(model, 2, 20, nsub, seed=5).windows(4)
    xi = space.uniform(6, np.random.default_rng(0))
    one, five = (MujocoSimulator(model, space, nthread=k, check_influence=False).predict(xi, windows) for k in (1, 5))
    np.testing.assert_array_equal(one, five)


def test_order_of_rows_does_not_matter():
    """Shuffled pairs of vector and window give shuffled results, and each pair alone the same again."""
    model, space, nsub = robot("hopper")
    sim = MujocoSimulator(model, space, check_influence=False)
    windows = record(model, 2, 12, nsub, seed=6).windows(3)
    xi = space.uniform(5, np.random.default_rng(0))
    vector, window = (i.ravel() for i in np.meshgrid(np.arange(5), np.arange(len(windows)), indexing="ij"))
    sorted_rows = sim.rollout(xi, windows, vector, window)
    order = np.random.default_rng(1).permutation(len(vector))
    np.testing.assert_array_equal(sim.rollout(xi, windows, vector[order], window[order]), sorted_rows[order])
    for r in order[:5]:
        alone = sim.rollout(xi, windows, vector[r : r + 1], window[r : r + 1])
        np.testing.assert_array_equal(alone[0], sorted_rows[r])


def test_calls_do_not_remember():
    """A call gives the same bits after calls of other sizes, horizons and parameters."""
    sim = arm()
    windows = make_windows(sim.model, 5, 2)
    xi = sim.space.uniform(3, np.random.default_rng(0))
    fresh = arm().predict(xi, windows)
    sim.predict(sim.space.uniform(40, np.random.default_rng(1)), make_windows(sim.model, 9, 6, seed=1))
    np.testing.assert_array_equal(sim.predict(xi, windows), fresh)


def test_memory_is_bounded(monkeypatch):
    """Losses of 10 x 400 pairs of 50 steps need a few times the numbers held at once, not those of all states."""
    monkeypatch.setattr(simulator, "CHUNK_NUMBERS", 1 << 14)
    model = load(PENDULUM)
    space = ParameterSpace([Parameter("dof_damping", "hinge", 0.0, 1.0)])
    sim = MujocoSimulator(model, space, check_influence=False)
    windows = make_windows(model, 400, 50)
    xi = space.uniform(10, np.random.default_rng(0))
    tracemalloc.start()
    sim.losses(xi, windows, np.ones(2))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    states = 10 * 400 * 50 * sim.states.nx * 8
    assert peak < 8 * simulator.CHUNK_NUMBERS * 8 < states / 3


def test_steps_are_counted():
    """The currency of estimators: one for every mj_step, constructor and both methods included."""
    sim = arm()
    assert sim.simulated_steps == 0
    sim.predict(sim.space.uniform(3, np.random.default_rng(0)), make_windows(sim.model, 4, 5, nsub=6))
    sim.losses(sim.space.low, make_windows(sim.model, 2, 1), np.ones(4))
    assert sim.simulated_steps == 3 * 4 * 5 * 6 + 2


def test_the_model_given_is_not_changed():
    """The simulator works on a copy, and loading a loaded model again changes nothing."""
    raw = load(DOUBLE_PENDULUM)
    before = raw.opt.disableflags, raw.body_mass.copy()
    sim = MujocoSimulator(raw, ParameterSpace([Parameter("body_mass", "lower", 1.0, 2.0)]))
    sim.predict([[2.0]], make_windows(raw, 1, 1))
    assert raw.opt.disableflags == before[0]
    np.testing.assert_array_equal(raw.body_mass, before[1])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"control_dt": 0.005}, "0.005 s is no multiple of the model's timestep 0.002 s; set the timestep to 0.0025 s"),
        ({"control_dt": 0.0005}, "set the timestep to 0.0005 s or resample"),
        ({"ctrl": np.zeros((3, 1, 3)), "history": np.zeros((3, 0, 3))}, "have nu=3 commands, the model nu=2"),
        ({"nq": 1, "nv": 3}, "the windows have nq=1, nv=3, the simulator nq=2, nv=2"),
    ],
)
def test_windows_of_another_robot_are_refused(change, text):
    """Step, commands and sizes have to fit."""
    sim = arm()
    windows = with_arrays(make_windows(sim.model, 3, 1), **change)
    with pytest.raises(BadInput, match=text):
        sim.losses(sim.space.low, windows, np.ones(4))


def test_control_steps_with_rounding_are_accepted():
    """A recorder's 0.006000000001 s is three steps of 0.002 s, and so is what differs from them by less than 0.1 %."""
    sim = arm()
    assert [sim.substeps(dt) for dt in (0.002, 0.006000000001, 0.005995, 0.006005, 0.3)] == [1, 3, 3, 3, 150]
    for dt in (0.00599, 0.00601):
        with pytest.raises(BadInput, match="no multiple of the model's timestep"):
            sim.substeps(dt)


def test_clocks_that_a_data_set_may_have_are_simulated():
    """A clock that drifts and a last stamp that is late: the simulations are those of an exact clock, bit by bit."""
    late = effect("actuation_delay", "elbow_motor", delay=(0.0, 0.01))
    sim = MujocoSimulator(load(DOUBLE_PENDULUM), None, [late, effect("backlash", "*", width=(0.0, 0.1))])
    (exact,) = record(sim.model, 1, 49, 5)

    def predicted(time):
        data = sim.prepare(Dataset([replace(exact, time=time)]))
        dt = data.control_dt
        windows = data.windows(3, history=sim.history_steps(dt), past=sim.past_steps(dt))
        return sim.predict([[0.005, 0.05]], windows)

    expected = predicted(exact.time)
    for time in (exact.time * 1.00002, exact.time * 1.0009, exact.time + 3e-6 * (np.arange(50) == 49)):
        np.testing.assert_array_equal(predicted(time), expected)


@pytest.mark.parametrize("scale", [np.ones(3), np.array([1, 1, 0, 1.0]), np.array([1, 1, np.nan, 1]), 1.0])
def test_bad_scales_are_refused(scale):
    """One positive number per channel."""
    sim = arm()
    with pytest.raises(BadInput, match="scale must be 4 positive numbers"):
        sim.losses(sim.space.low, make_windows(sim.model, 1, 1), scale)


def test_parameters_outside_their_box_are_refused():
    """The simulator checks every vector against its space."""
    sim = arm()
    with pytest.raises(BadParameter, match="row 0: body_mass:lower = 0 lies outside"):
        sim.predict(sim.space.low * 0, make_windows(sim.model, 1, 1))


def test_quaternion_models_too():
    """A free box over a floor: 7 positions, 6 velocities, 12 channels; losses of a state against itself are 0."""
    model = load(FREE_BOX)
    sim = MujocoSimulator(model, ParameterSpace([Parameter("body_mass", "box", 0.5, 2.0)]), check_influence=False)
    windows = make_windows(model, 4, 3, nsub=5)
    predicted = sim.predict([[1.3]], windows)[0]
    assert predicted.shape == (4, 3, 13)
    own = np.concatenate([windows.state[:, :1], predicted], axis=1)
    flipped = own.copy()
    flipped[:, 1:, 3:7] *= -1
    for state in (own, flipped):
        assert sim.losses([[1.3]], with_arrays(windows, state=state), np.ones(12)).max() < 1e-24
    assert squared_error(sim.states, predicted, windows.target, np.ones(12)).min() > 1


def test_windows_without_commands():
    """A robot without actuators has windows with nu = 0, and falls as plain MuJoCo lets it."""
    model = load(FREE_BOX)
    assert model.nu == 0
    sim = MujocoSimulator(model, ParameterSpace([Parameter("opt.gravity", low=-20, high=-1, component=2)]))
    windows = make_windows(model, 3, 4, nsub=5)
    predicted = sim.predict([[-4.0], [-9.81]], windows)
    for n in range(3):
        nothing = np.zeros((4, 0))
        np.testing.assert_array_equal(predicted[1, n], plain_rollout(sim.model, windows.start[n], nothing, 5))
    # in free flight all that gravity does to a vertical speed is time times the difference
    gained = 5.81 * 5 * model.opt.timestep * np.arange(1, 5)
    away = (predicted[0] - predicted[1])[..., 9]
    np.testing.assert_allclose(away[:, 0], gained[0], atol=1e-12)


def test_no_rows_are_no_residuals():
    """Without a vector or a window answers are empty, of the shape that any other number would have."""
    sim, space = arm(), arm().space
    windows = record(load(DOUBLE_PENDULUM), 1, 9, 2, seed=2).windows(2)
    scale, none = np.ones(windows.horizon * sim.states.ndiff), np.zeros(0, dtype=np.intp)
    xi = space.uniform(3, np.random.default_rng(0))
    assert sim.residuals(xi, windows, none, none, scale).shape == (0, len(scale))
    assert sim.losses(np.empty((0, 3)), windows, scale[: sim.states.ndiff]).shape == (0, len(windows))
