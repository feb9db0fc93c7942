"""WarpSimulator, on Warp's CPU device or a GPU, against MujocoSimulator, its twin in double precision."""

import weakref

import mujoco
import numpy as np
import pytest
import torch
import warp as wp

import nfpde
from nfpde.bench import losses
from nfpde.bench.gap.robots import MODELS
from nfpde.benchmarks import ROBOTS
from nfpde.effects import effect
from nfpde.errors import BadInput
from nfpde.estimation import NfpdeConfig
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import LOSS_LIMIT, MujocoSimulator, make_simulator, runs_on, warp_batches
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.warp_memory import Counter, passing_bytes
from tests.device import WARP
from tests.models import BALL, DOUBLE_PENDULUM, PENDULUM, load, make_windows, record, with_arrays

# Squared one-step difference, qpos and qvel together, of MuJoCo Warp's float32 from MuJoCo's float64, over 760 random
# steps of each of these robots, until they fall: at most 3e-7, half of them below 3e-10. (On the ground, where six
# contacts share the weight, the solver's single precision is worse: 3e-5 was seen.)
WORST, MIDDLE = 1e-6, 2e-9

HOPPER_SUBSTEPS = 4


def arm(**options):
    space = ParameterSpace(
        [
            Parameter("body_mass", "lower", 0.3, 1.5),
            Parameter("dof_damping", "shoulder", 0.0, 1.0),
            Parameter("dof_frictionloss", "elbow", 0.0, 0.3),
        ]
    )
    return WarpSimulator(load(DOUBLE_PENDULUM), space, device=WARP, check_influence=False, **options)


def vectors(sim, n, seed=0):
    return sim.space.uniform(n, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def sim():
    return arm()


@pytest.mark.parametrize("name", ROBOTS)
def test_agrees_with_mujoco_to_single_precision(name):
    """Losses and predictions of the four robots, in the air and in contact, with results poisoned beforehand."""
    robot = ROBOTS[name]
    sim = WarpSimulator(robot.model, robot.space, device=WARP, check_influence=False)
    recorded = losses._record(robot, episodes=3, steps=30).transitions()
    windows = recorded[np.arange(0, len(recorded), 3)]
    xi, one = vectors(sim, 3), np.ones(sim.states.ndiff)
    expected = sim.reference.losses(xi, windows, one)
    states = sim.reference.predict(xi, windows)
    sim.losses(xi, windows, one)
    sim.predict(xi, windows)
    for batch in sim._batches.kept.values():
        batch.poison()
    found, predicted = sim.losses(xi, windows, one), sim.predict(xi, windows)
    square = (sim.states.difference(predicted, states) ** 2).sum((2, 3))
    assert square.max() < WORST
    assert np.median(square) < MIDDLE
    # |a|^2 - |b|^2 is at most |a-b| (2|b| + |a-b|)
    root = np.sqrt(WORST)
    assert (np.abs(found - expected) < root * (2 * np.sqrt(expected) + root)).all()
    assert np.median(np.abs(found - expected)) < np.sqrt(MIDDLE) * 2 * np.sqrt(np.median(expected))
    # what has run leaves the model as it was, which is one for all simulators of it
    again = WarpSimulator(robot.model, robot.space, device=WARP, check_influence=False)
    anew = again.losses(xi, windows, one)
    assert (np.abs(anew - expected) < root * (2 * np.sqrt(expected) + root)).all()


def test_windows_of_many_steps(sim):
    """Ten control steps of three physics steps each, whitened: losses and all predicted states."""
    windows = make_windows(sim.model, 6, 10, nsub=3)
    xi, scale = vectors(sim, 4), np.array([0.1, 0.2, 2.0, 3.0])
    expected = sim.reference.losses(xi, windows, scale)
    # positions and velocities of a few units, thirty steps: rounding of 6e-8 grows to 1e-5 of the loss
    np.testing.assert_allclose(sim.losses(xi, windows, scale), expected, rtol=1e-4)
    np.testing.assert_allclose(sim.predict(xi, windows), sim.reference.predict(xi, windows), atol=2e-5)


@pytest.mark.parametrize("xml", [BALL, (MODELS / "rover.xml").read_text()])
def test_quaternions(xml):
    """Differences of rotations are taken as the twin takes them, with targets turned by any angle."""
    field = Parameter("opt.gravity", None, -11.0, -9.0, component=2)
    sim = WarpSimulator(load(xml), ParameterSpace([field]), device=WARP, check_influence=False)
    windows = make_windows(sim.model, 12, 1, spread=1.5)
    xi, scale = vectors(sim, 2), np.linspace(0.5, 2.0, sim.states.ndiff)
    expected = sim.reference.losses(xi, windows, scale)
    np.testing.assert_allclose(sim.losses(xi, windows, scale), expected, rtol=1e-5)


def test_chunks_change_nothing(sim):
    """As many worlds at once as fit, a few, or one: the same bits."""
    windows, xi = make_windows(sim.model, 7, 2), vectors(sim, 5)
    expected = sim.losses(xi, windows, np.ones(4))
    states = sim.predict(xi, windows)
    for nworld in (1, 4, 6, 35):
        small = arm(nworld=nworld)
        np.testing.assert_array_equal(small.losses(xi, windows, np.ones(4)), expected)
        np.testing.assert_array_equal(small.predict(xi, windows), states)


def test_losses_reach_torch_without_a_copy(sim):
    """The tensor is the batch's own memory: what is written there shows in it, and in no array that was copied."""
    windows, xi = make_windows(sim.model, 5, 2), vectors(sim, 3)
    copied = sim.losses(xi, windows, np.ones(4))
    shared = torch.from_dlpack(sim.losses_on_device(xi, windows, np.ones(4)))
    assert shared.dtype == torch.float64
    np.testing.assert_array_equal(shared.cpu().numpy(), copied)
    batch = next(reversed(sim._batches.kept.values()))
    batch._loss.fill_(7.0)
    assert bool((shared == 7.0).all())
    assert shared.data_ptr() == batch._loss.ptr
    assert not (copied == 7.0).any()


def test_losses_of_several_chunks_are_one_tensor(sim):
    """Chunks are put together on the device, in the order of vectors and windows."""
    windows, xi = make_windows(sim.model, 7, 2), vectors(sim, 5)
    parts = torch.from_dlpack(arm(nworld=6).losses_on_device(xi, windows, np.ones(4)))
    np.testing.assert_array_equal(parts.cpu().numpy(), sim.losses(xi, windows, np.ones(4)))


def test_the_trainer_takes_losses_where_they_are(sim, monkeypatch):
    """A fit by softmax asks for losses on the device, never for copies on the host."""
    monkeypatch.setattr(WarpSimulator, "losses", lambda *_: pytest.fail("losses were copied to the host"))
    config = NfpdeConfig(iterations=2, samples=8, transitions=4, gradient_steps=1, transforms=1, hidden=4)
    result = nfpde.fit(sim, record(sim.model, 2, 6, 2), method="softmax", config=config, quiet=True)
    assert len(result.history) == 2


def test_the_trainer_goes_the_same_way_on_either_device(sim):
    """One step of the trainer moves the flow as it does with losses of double precision."""
    config = NfpdeConfig(
        iterations=1, samples=64, transitions=16, gradient_steps=1, transforms=2, hidden=8, beta=1.0, scale="increment"
    )
    dataset = record(sim.model, 2, 12, 2)
    steps = []
    for simulator in (sim, sim.reference):
        result = nfpde.fit(simulator, dataset, method="softmax", config=config, seed=3, quiet=True)
        assert result.initial is not None
        flows = [d.density for d in (result.distribution, result.initial)]
        numbers = [
            torch.cat([p.detach().ravel() for p in f.parameters()]) for f in flows if isinstance(f, torch.nn.Module)
        ]
        steps.append((numbers[0] - numbers[1]).numpy())
    assert np.linalg.norm(steps[0]) > 0
    # Adam's first step has the signs of the gradient: rounding may turn those of components that are nearly zero
    assert steps[0] @ steps[1] > 0.99 * np.linalg.norm(steps[0]) * np.linalg.norm(steps[1])


def test_buffers_can_be_given_back():
    """Nothing is kept after `release`, and the same losses come from new buffers."""
    sim = arm()
    windows, xi = make_windows(sim.model, 5, 3), vectors(sim, 4)
    before = sim.losses(xi, windows, np.ones(4))
    buffers = weakref.ref(next(iter(sim._batches.kept.values())))
    sim.release()
    assert buffers() is None
    np.testing.assert_array_equal(sim.losses(xi, windows, np.ones(4)), before)


def test_memory_of_a_world_is_its_own(monkeypatch):
    """As much is predicted in a fresh process as after many worlds have run, and a step's buffers are part of it."""
    windows = make_windows(load(DOUBLE_PENDULUM), 50, 2)
    sizes = []
    for nvector in (2, 60, 2):
        monkeypatch.setattr(warp_batches, "FOOTPRINTS", {})  # else what was measured first is what is read
        sim = arm()
        sim.losses(vectors(sim, nvector), windows, np.ones(4))
        kind = next(iter(sim._batches.kept))
        sizes.append(sim._batches.footprint(kind))
    assert sizes[0] == sizes[1] == sizes[2]
    few, many = (passing_bytes(sim._model, kind, n, sim.device) for n in (3, 30))
    # the solver's vectors of single precision: one of each constraint, and of each degree of freedom more than one
    assert many - few > 27 * 4 * (kind.njmax + sim.model.nv)
    assert sizes[0].world > (many - few) // 27
    assert not isinstance(wp.get_device_allocator(sim.device), Counter)


@pytest.mark.parametrize(("nvector", "nwindow"), [(0, 4), (1, 0), (0, 0)])
def test_no_vectors_or_no_windows(sim, nvector, nwindow):
    """Nothing to simulate is answered as the twin answers it: with arrays of the shapes asked for."""
    windows, xi = make_windows(sim.model, 4, 2)[np.arange(nwindow)], vectors(sim, nvector)
    assert sim.reference.predict(xi, windows).shape == (nvector, nwindow, 2, 4)
    assert sim.predict(xi, windows).shape == (nvector, nwindow, 2, 4)
    assert sim.reference.losses(xi, windows, np.ones(4)).shape == (nvector, nwindow)
    assert sim.losses(xi, windows, np.ones(4)).shape == (nvector, nwindow)
    assert torch.from_dlpack(sim.losses_on_device(xi, windows, np.ones(4))).shape == (nvector, nwindow)


def test_any_pairs_in_any_order(sim):
    """`rollout` gives each row its own vector and window."""
    windows, xi = make_windows(sim.model, 5, 3), vectors(sim, 4)
    rng = np.random.default_rng(2)
    vector, window = rng.integers(0, 4, 11), rng.integers(0, 5, 11)
    rows = sim.rollout(xi, windows, vector, window)
    # the host derives the model's constants here, the device there: they differ in the last bit
    np.testing.assert_allclose(rows, sim.predict(xi, windows)[vector, window], atol=1e-6)


def test_no_world_reads_what_was_not_sent(sim):
    """Fewer rows than worlds: what the buffers held beyond them, here NaN, reaches no answer."""
    windows, xi = make_windows(sim.model, 5, 3), vectors(sim, 4)
    vector, window = np.arange(11) % 4, np.arange(11) % 5
    before = sim.rollout(xi, windows, vector, window)
    batch = next(reversed(sim._batches.kept.values()))
    assert batch.sizes.nworld > len(vector)
    batch.poison()
    np.testing.assert_array_equal(sim.rollout(xi, windows, vector, window), before)
    assert np.isnan(batch._state.numpy()[5:]).all()


def test_a_call_leaves_no_trace(sim):
    """The same losses whatever was simulated before: other parameters, other windows, a world that diverged."""
    windows, xi = make_windows(sim.model, 4, 2), vectors(sim, 3)
    before = sim.losses(xi, windows, np.ones(4))
    sim.losses(vectors(sim, 3, seed=1), make_windows(sim.model, 4, 2, seed=5, speed=1e9), np.ones(4))
    np.testing.assert_array_equal(sim.losses(xi, windows, np.ones(4)), before)


def test_simulators_of_one_model_leave_no_trace_in_each_other(sim):
    """They share what no parameter changes: another one, whose parameters derive other constants, moves no bit."""
    windows, xi = make_windows(sim.model, 4, 2), vectors(sim, 3)
    before = sim.losses(xi, windows, np.ones(4))
    heavy = ParameterSpace([Parameter("body_mass", "upper", 5.0, 9.0), Parameter("opt.density", None, 10.0, 500.0)])
    other = WarpSimulator(load(DOUBLE_PENDULUM), heavy, device=WARP, check_influence=False)
    assert other._model.nominal.dof_parentid.ptr == arm()._model.nominal.dof_parentid.ptr
    found = other.losses(vectors(other, 3), windows, np.ones(4))
    np.testing.assert_allclose(found, other.reference.losses(vectors(other, 3), windows, np.ones(4)), rtol=1e-4)
    np.testing.assert_array_equal(sim.losses(xi, windows, np.ones(4)), before)
    np.testing.assert_array_equal(arm().losses(xi, windows, np.ones(4)), before)


def test_divergence_is_nan_and_the_limit():
    """A spring that pushes its joint over: NaN from one step to the end, the limit as loss, neighbours unharmed."""
    space = ParameterSpace([Parameter("jnt_stiffness", "hinge", -1e6, 1.0)])
    sim = WarpSimulator(load(PENDULUM), space, device=WARP, check_influence=False)
    windows = make_windows(sim.model, 3, 40)
    good = np.array([[0.5], [0.1]])
    mixed = np.array([[0.5], [-1e6], [0.1]])
    predicted = sim.predict(mixed, windows)
    gone = np.isnan(predicted[1]).all(2)
    assert gone[:, -1].all()
    assert not gone[:, 0].any()
    assert (np.diff(gone.astype(int), axis=1) >= 0).all()
    np.testing.assert_array_equal(np.isnan(predicted[1]).any(2), gone)
    np.testing.assert_array_equal(predicted[[0, 2]], sim.predict(good, windows))
    found = sim.losses(mixed, windows, np.ones(2))
    np.testing.assert_array_equal(found[1], LOSS_LIMIT)
    np.testing.assert_array_equal(found[[0, 2]], sim.losses(good, windows, np.ones(2)))


def touching(model, state):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    mujoco.mj_forward(model, data)
    return data.ncon


def test_buffers_that_overflow_grow():
    """With room for one contact and one constraint the answers are those of large buffers, not of fewer contacts."""
    robot = ROBOTS["hopper"]
    sim = WarpSimulator(robot.model, robot.space, device=WARP, check_influence=False)
    recorded = record(robot.model, 1, 100, HOPPER_SUBSTEPS, seed=1).transitions()
    windows = recorded[np.flatnonzero([touching(robot.model, start) > 1 for start in recorded.start])]
    assert len(windows) > 3
    xi, one = vectors(sim, 2), np.ones(sim.states.ndiff)
    expected = sim.losses(xi, windows, one)
    sim._buffers = (1, 1)
    np.testing.assert_allclose(sim.losses(xi, windows, one), expected, rtol=1e-4)
    assert sim._buffers[0] > 1
    assert sim._buffers[1] > 1


def test_geoms_that_do_not_move_have_a_place_in_each_world():
    """The floor's height as parameter, which MuJoCo Warp computes once for all worlds."""
    robot = ROBOTS["hopper"]
    space = ParameterSpace([Parameter("geom_pos", "floor", -0.1, 0.1, component=2)])
    sim = WarpSimulator(robot.model, space, device=WARP, check_influence=False)
    windows = record(robot.model, 1, 30, HOPPER_SUBSTEPS, seed=1).transitions()[np.arange(15, 30)]
    xi = np.array([[-0.1], [0.01], [0.03]])
    expected = sim.reference.predict(xi, windows)
    assert np.abs(np.diff(expected, axis=0)).max() > 0.01
    square = ((sim.predict(xi, windows) - expected) ** 2).sum((2, 3))
    assert square.max() < WORST


def test_a_fluid_that_the_model_lacks():
    """MuJoCo Warp decides once whether there is a fluid; a density above 0 within the bounds switches it on."""
    space = ParameterSpace([Parameter("opt.density", None, 0.0, 500.0)])
    sim = WarpSimulator(load(DOUBLE_PENDULUM), space, device=WARP, check_influence=False)
    windows = make_windows(sim.model, 4, 20, speed=3.0)
    xi = np.array([[0.0], [200.0], [500.0]])
    expected = sim.reference.predict(xi, windows)
    assert np.abs(expected[2] - expected[0]).max() > 1e-2
    np.testing.assert_allclose(sim.predict(xi, windows), expected, atol=2e-5)


def test_effects_on_the_model_need_no_kernel():
    """Coulomb friction is written into the rows of the model."""
    model = load(DOUBLE_PENDULUM)
    effects = [effect("coulomb_friction", "elbow", torque=(0.0, 0.5))]
    sim = WarpSimulator(model, None, effects, device=WARP, check_influence=False)
    windows = make_windows(sim.model, 4, 5)
    np.testing.assert_allclose(
        sim.predict([[0.0], [0.4]], windows), sim.reference.predict([[0.0], [0.4]], windows), atol=2e-5
    )


def test_says_what_it_is(sim):
    """A run on one device is not resumed on another, and people can read where it ran."""
    other = MujocoSimulator(load(DOUBLE_PENDULUM), sim.space, check_influence=False)
    assert sim.identity() != other.identity()
    assert runs_on(sim).startswith(f"{WARP}: MuJoCo Warp")
    assert runs_on(other).startswith("cpu: MuJoCo")


def test_counts_the_same_steps(sim):
    """Physics steps are counted as the twin counts them."""
    windows, xi = make_windows(sim.model, 3, 2, nsub=2), vectors(sim, 4)
    before = sim.simulated_steps, sim.reference.simulated_steps
    for s in (sim, sim.reference):
        s.losses(xi, windows, np.ones(4))
        s.predict(xi, windows)
    assert sim.simulated_steps - before[0] == sim.reference.simulated_steps - before[1] == 2 * 4 * 3 * 2 * 2


def test_wrong_scale_and_windows(sim):
    """What the twin refuses, with the rule."""
    windows, xi = make_windows(sim.model, 2, 1), vectors(sim, 1)
    with pytest.raises(BadInput, match="scale must be 4 positive numbers"):
        sim.losses(xi, windows, np.ones(3))
    fewer = with_arrays(windows, ctrl=windows.ctrl[:, :, :1], history=windows.history[:, :, :1])
    with pytest.raises(BadInput, match="nu="):
        sim.losses(xi, fewer, np.ones(4))


def test_auto_is_the_cpu_where_there_is_no_gpu(monkeypatch):
    """`auto` takes CUDA only if there is one."""
    monkeypatch.setattr("nfpde.sim.select._finds_cuda", lambda: False)
    space = ParameterSpace([Parameter("dof_damping", "hinge", 0.0, 1.0)])
    assert isinstance(make_simulator(load(PENDULUM), space, check_influence=False), MujocoSimulator)
    sim = make_simulator(load(PENDULUM), space, device=WARP, check_influence=False)
    assert isinstance(sim, WarpSimulator)
