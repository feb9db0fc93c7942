"""What WarpSimulator refuses: each error names the thing and what to do."""

import warnings
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.errors import BadInput, BadModel
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import Whitening, make_simulator, warp_batch, warp_batches, warp_device, warp_family, warp_model
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.warp_batch import WarpBatch
from nfpde.sim.warp_memory import Footprint, passing_bytes
from nfpde.sim.warp_overflow import CONSTRAINTS
from nfpde.sim.warp_sizes import LEAST_CONSTRAINTS
from tests.models import DOUBLE_PENDULUM, PENDULUM, load, make_windows

SPACE = ParameterSpace([Parameter("dof_damping", "hinge", 0.0, 1.0)])


def pendulum(model=None, **options):
    return WarpSimulator(model or load(PENDULUM), SPACE, device="warp-cpu", check_influence=False, **options)


def test_no_gpu(monkeypatch):
    """Without a CUDA device the text says what to check and what runs anyway."""
    monkeypatch.setattr(warp_device, "has_cuda", lambda: False)
    with pytest.raises(BadInput, match=r"finds no CUDA device; check that nvidia-smi .* or use device='cpu'"):
        make_simulator(load(PENDULUM), SPACE, device="cuda", check_influence=False)


def test_unknown_device():
    """A device that does not exist, with those that do."""
    device: Any = "tpu"
    with pytest.raises(BadInput, match="'tpu'; there are: auto, cpu, cuda, warp-cpu"):
        make_simulator(load(PENDULUM), SPACE, device=device, check_influence=False)


def test_a_gpu_without_memory_pools(monkeypatch):
    """Steps allocate while they are captured, which needs pools; it is not memory that lacks."""
    bare = SimpleNamespace(is_cuda=True, is_mempool_enabled=False)
    monkeypatch.setattr(warp_device, "has_cuda", lambda: True)
    monkeypatch.setattr(warp_device.wp, "get_device", lambda name: bare)
    with pytest.raises(BadInput, match=r"need CUDA's memory pools.*or use device='cpu'"):
        warp_device.open_device("cuda")


def test_negative_number_of_worlds():
    """Worlds at once are counted from 1; 0 leaves the number to the memory."""
    with pytest.raises(BadInput, match="nworld must be positive, or 0"):
        pendulum(nworld=-1)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda m: setattr(m.opt, "disableflags", int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)), "MIDPHASE"),
        (lambda m: m.actuator_gaintype.fill(int(mujoco.mjtGain.mjGAIN_USER)), "actuators of type user"),
    ],
)
def test_features_that_warp_lacks(change, text):
    """MuJoCo Warp's own word for the feature, and what to do."""
    model = load(PENDULUM)
    change(model)
    with pytest.raises(BadModel, match=rf"MuJoCo Warp cannot run this model: .*{text}.* device='cpu'"):
        pendulum(model)


def test_sizes_that_warp_lacks():
    """A dense Jacobian of 61 degrees of freedom is one too many: its own words, what to do, and the cause attached."""
    body = '<body name="{}"><joint type="slide"/><geom size=".1" contype="0" conaffinity="0"/></body>'
    bodies = "".join(body.format(f"b{i}") for i in range(61))
    space = ParameterSpace([Parameter("body_mass", "b0", 0.1, 1.0)])
    model = load(f"<mujoco><option jacobian='dense'/><worldbody>{bodies}</worldbody></mujoco>")
    with pytest.raises(BadModel, match=r"cannot run this model: Dense is unsupported.* device='cpu'") as refused:
        WarpSimulator(model, space, device="warp-cpu", check_influence=False)
    assert isinstance(refused.value.__cause__, ValueError)


def test_what_warp_computes_otherwise(monkeypatch):
    """A warning that results will not be MuJoCo's is no result: its own words, and what to do."""

    def put_model(model):
        warnings.warn("Bending damping is not yet supported.", stacklevel=1)

    monkeypatch.setattr(warp_model.mjw, "put_model", put_model)
    monkeypatch.setattr(warp_model, "_LAST", {})
    with pytest.raises(BadModel, match=r"cannot run this model: Bending damping is not yet .* device='cpu'"):
        pendulum()


def test_floors_without_friction():
    """What slides on ice is simulated as MuJoCo does, which gives every contact the least friction there is."""
    ice = """
    <mujoco><default><geom friction="0 0 0"/></default><worldbody>
      <geom type="plane" size="1 1 1"/>
      <body name="puck" pos="0 0 .1"><joint name="x" type="slide" axis="1 0 0"/>
        <joint name="z" type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
    </worldbody></mujoco>"""
    space = ParameterSpace([Parameter("dof_damping", "x", 0.0, 1.0)])
    windows = make_windows(load(ice), n=4, horizon=5, spread=0.01, speed=0.1)
    there = [
        make_simulator(load(ice), space, device=device, check_influence=False).predict([[0.5]], windows)
        for device in ("cpu", "warp-cpu")
    ]
    assert there[1] == pytest.approx(there[0], abs=1e-4)  # single precision


def test_a_field_that_all_worlds_share():
    """What no world can have of its own is refused before anything is simulated with wrong numbers."""
    xml = PENDULUM.replace("<geom name=", '<geom fluidshape="ellipsoid" name=')
    space = ParameterSpace([Parameter("geom_fluid", "bob", 0.1, 1.0, component=1)])
    with pytest.raises(BadModel, match=r"no geom_fluid of each world's own.*leave out the parameter"):
        WarpSimulator(load(xml), space, device="warp-cpu", check_influence=False)


SPRINGS, DAMPERS = int(mujoco.mjtDisableBit.mjDSBL_SPRING), int(mujoco.mjtDisableBit.mjDSBL_DAMPER)


@pytest.mark.parametrize("disabled", [0, SPRINGS, DAMPERS])
def test_every_evaluation_of_runge_kutta_is_checked(monkeypatch, disabled):
    """All four of a step look for buffers that overflow: once as kernels are loaded, once as the step is captured."""
    looked = []
    monkeypatch.setattr(warp_batch, "flag_overflow", lambda m, d: looked.append(d))
    model = load(PENDULUM)
    model.opt.integrator, model.opt.disableflags = mujoco.mjtIntegrator.mjINT_RK4, disabled
    sim = pendulum(model)
    sim.losses([[0.5]], make_windows(model, 2, 1), np.ones(2))
    (batch,) = sim._batches.kept.values()
    assert sum(d is batch.d for d in looked) == 2 * 4


def test_runge_kutta_without_passive_forces():
    """Where springs and dampers are both disabled, three of its four evaluations would go unchecked."""
    model = load(PENDULUM)
    model.opt.integrator, model.opt.disableflags = mujoco.mjtIntegrator.mjINT_RK4, SPRINGS | DAMPERS
    with pytest.raises(BadModel, match=r"springs and dampers are both disabled.*RK4.*or use device='cpu'"):
        pendulum(model)


def test_one_evaluation_without_passive_forces():
    """Other integrators have one in a step, whose buffers MuJoCo Warp checks at its end."""
    model = load(DOUBLE_PENDULUM)
    model.opt.disableflags = SPRINGS | DAMPERS
    joints = [Parameter("dof_frictionloss", joint, 0.1, 0.5) for joint in ("shoulder", "elbow")]
    sim = WarpSimulator(model, ParameterSpace(joints), device="warp-cpu", check_influence=False)
    windows = make_windows(model, 4, 5)
    sim._buffers = (1, 1)
    expected = sim.reference.predict([[0.3, 0.4]], windows)
    np.testing.assert_allclose(sim.predict([[0.3, 0.4]], windows), expected, atol=2e-5)
    assert sim.usage().njmax == 2


def test_pgs_is_replaced():
    """The PGS solver, which MuJoCo Warp lacks, is Newton's here as in every simulator of the package."""
    model = load(DOUBLE_PENDULUM)
    model.opt.solver = mujoco.mjtSolver.mjSOL_PGS
    space = ParameterSpace([Parameter("dof_frictionloss", "elbow", 0.0, 1.0)])
    sim = WarpSimulator(model, space, device="warp-cpu", check_influence=False)
    windows = make_windows(sim.model, 2, 2)
    np.testing.assert_allclose(sim.predict([[0.5]], windows), sim.reference.predict([[0.5]], windows), atol=1e-5)


@pytest.fixture
def small_memory(monkeypatch):
    """A device with 4 MiB: what is allocated beyond fails as Warp's allocators fail."""
    budget = 4 << 20
    held: dict[Any, int] = {}
    allocator: Any = type(warp_device.open_device("warp-cpu").get_allocator())
    allocate, deallocate = allocator.allocate, allocator.deallocate

    def limited(self, size):
        if sum(held.values()) + size > budget:
            raise RuntimeError(f"Failed to allocate {size} bytes on device 'cpu'")
        pointer = allocate(self, size)
        held[pointer] = size
        return pointer

    def freed(self, pointer, size):
        held.pop(pointer, None)
        deallocate(self, pointer, size)

    monkeypatch.setattr(allocator, "allocate", limited)
    monkeypatch.setattr(allocator, "deallocate", freed)
    # the other half is for what a step allocates and gives back, which is known in advance on a GPU only
    for module in (warp_batches, warp_device):
        monkeypatch.setattr(module, "free_bytes", lambda _: (budget - sum(held.values())) // 2)
    # nothing is known or kept from earlier simulators
    monkeypatch.setattr(warp_family, "FOOTPRINTS", {})
    monkeypatch.setattr(warp_batches, "FOOTPRINTS", warp_family.FOOTPRINTS)
    monkeypatch.setattr(warp_model, "_FLAGS", {})
    warp_family.free_shared(warp_device.open_device("warp-cpu"))
    return held


@pytest.mark.parametrize("others", [0, 3 << 20])
def test_out_of_memory_names_the_worlds_that_fit(small_memory, others):
    """Too many worlds at once: the text has a number, and as many do fit, beside what others took since."""
    windows = make_windows(load(PENDULUM), 400, 1)
    xi, one = [[d] for d in np.linspace(0.1, 0.9, 20)], np.ones(2)
    sim = pendulum(nworld=8000)
    small_memory["others"] = others
    with pytest.raises(BadInput, match=r"cpu: no memory for 8000 worlds of about \d+ KiB .*pass nworld=\d+") as error:
        sim.losses(xi, windows, one)
    fitting = int(str(error.value).split("nworld=")[1].split(",")[0])
    assert 20 < fitting < 8000
    del sim  # the error alone, which somebody may keep, holds no buffers
    found = pendulum(nworld=fitting).losses(xi, windows, one)
    np.testing.assert_allclose(found, pendulum().reference.losses(xi, windows, one), rtol=1e-4)


def test_as_many_worlds_as_fit(small_memory):
    """Without a number, the pairs that do not fit at once run in turn, and nothing fails."""
    windows = make_windows(load(PENDULUM), 400, 1)
    sim = pendulum()
    sim.losses([[d] for d in np.linspace(0.1, 0.9, 20)], windows, np.ones(2))
    assert sim.usage().nworld < 8000
    assert sum(small_memory.values()) > 1 << 20


@pytest.mark.parametrize("first", [1, 3])
@pytest.mark.parametrize("call", ["losses", "rollout"])
def test_larger_buffers_in_full_memory(small_memory, monkeypatch, first, call):
    """Where constraints overflow, in the first piece or a later one, fewer worlds run at once, with the same answer."""
    windows = make_windows(load(PENDULUM), 400, 1)
    xi, one = np.linspace(0.1, 0.9, 20)[:, None], np.ones(2)
    real, worlds = WarpBatch.run, []

    def run(self, scale):
        worlds.append(self.sizes.nworld)
        found = real(self, scale)
        return CONSTRAINTS if len(worlds) >= first and self.sizes.njmax < 200 else found

    monkeypatch.setattr(WarpBatch, "run", run)
    sim = pendulum()
    if call == "losses":
        np.testing.assert_allclose(sim.losses(xi, windows, one), sim.reference.losses(xi, windows, one), rtol=1e-4)
    else:
        pairs = np.repeat(np.arange(20), 400), np.tile(np.arange(400), 20)
        expected = sim.reference.rollout(xi, windows, *pairs)
        np.testing.assert_allclose(sim.rollout(xi, windows, *pairs), expected, rtol=1e-4, atol=1e-6)
    assert worlds[0] > 2 * worlds[-1]


def test_simulators_that_keep_buffers_give_way(small_memory):
    """What others keep for their next call is given back before a simulator is told that there is no memory."""
    windows = make_windows(load(PENDULUM), 400, 1)
    xi, one = np.linspace(0.1, 0.9, 20)[:, None], np.ones(2)
    others = [pendulum(), pendulum()]
    for other in others:
        other.losses(xi, windows, one)
    sim = pendulum()
    held = sum(small_memory.values())
    small_memory["foreign"] = (4 << 20) - held
    np.testing.assert_allclose(sim.losses(xi, windows, one), sim.reference.losses(xi, windows, one), rtol=1e-4)
    assert not any(other._batches.kept for other in others)
    del small_memory["foreign"]
    np.testing.assert_allclose(others[0].losses(xi, windows, one), sim.losses(xi, windows, one), rtol=1e-4)


def test_own_buffers_give_way(small_memory):
    """What a simulator kept of its last call is room for the next, although nobody else has anything to give."""
    windows = make_windows(load(PENDULUM), 108, 1)
    sim = pendulum()
    sim.losses([[0.5]], windows[np.arange(102)], np.ones(2))
    small_memory["foreign"] = (4 << 20) - sum(small_memory.values()) - (300 << 10)
    expected = sim.reference.losses([[0.5]], windows, np.ones(2))
    np.testing.assert_allclose(sim.losses([[0.5]], windows, np.ones(2)), expected, rtol=1e-4)


def test_a_step_that_never_finds_memory(monkeypatch):
    """A batch that is made, and shared, but cannot run: what it took itself is no room for another try."""
    ran = []

    def run(self, scale):
        ran.append(self)
        assert len(ran) < 5
        raise RuntimeError("Failed to allocate 8 bytes on device 'cpu'")

    monkeypatch.setattr(WarpBatch, "run", run)
    sim = pendulum()
    with pytest.raises(BadInput, match="no memory for 4 worlds"):
        sim.predict([[0.5]], make_windows(sim.model, 4, 1))


def test_friction_that_a_sparse_model_lacks(small_memory):
    """MuJoCo Warp makes room in sparse Jacobians for friction of the nominal model alone: ours has it for any."""
    xml = DOUBLE_PENDULUM.replace("<option ", '<option jacobian="sparse" ')
    model = load(xml.replace("<geom ", '<geom contype="0" conaffinity="0" '))
    joints = [Parameter("dof_frictionloss", joint, 0.0, 0.5) for joint in ("shoulder", "elbow")]
    sim = WarpSimulator(model, ParameterSpace(joints), device="warp-cpu", check_influence=False)
    windows = make_windows(model, 4, 5)
    expected = sim.reference.predict([[0.3, 0.4]], windows)
    np.testing.assert_allclose(sim.predict([[0.3, 0.4]], windows), expected, atol=2e-5)
    assert sim.usage().njmax == LEAST_CONSTRAINTS


def test_no_memory_at_all(small_memory, monkeypatch):
    """Neither for a model, nor for the few worlds whose size is measured; once there is, all goes on."""
    windows, one = make_windows(load(PENDULUM), 4, 1), np.ones(2)
    sim = pendulum()
    small_memory["foreign"] = 4 << 20
    with pytest.raises(BadInput, match=r"no memory for a few worlds, whose size is measured, beside"):
        sim.losses([[0.5]], windows, one)
    monkeypatch.setattr(warp_model, "_LAST", {})  # else it is there already
    with pytest.raises(BadInput, match=r"no memory for the model beside"):
        pendulum()
    del small_memory["foreign"]
    expected = sim.reference.losses([[0.5]], windows, one)
    np.testing.assert_allclose(sim.losses([[0.5]], windows, one), expected, rtol=1e-4)


def test_out_of_memory_beside_the_worlds(small_memory):
    """What is no world's buffer has a text of its own."""
    windows = make_windows(load(PENDULUM), 20_000, 1)
    own = np.tile(np.eye(2), (20_000, 1, 1))
    whitening = Whitening(own, np.zeros_like(own), np.zeros(20_000, bool), 4.0)
    small_memory["others"] = 3 << 20
    sim = pendulum(nworld=4)
    with pytest.raises(BadInput, match=r"no memory for the whitening of 20000 windows beside the worlds; pass a sm"):
        sim.costs(np.array([[0.5]]), windows, np.zeros(2, int), np.arange(2), np.ones(2), whitening)


def test_other_errors_of_warp_pass(monkeypatch):
    """An error that is not about memory is not taken for one."""
    sim = pendulum()

    def broken(*_):
        raise RuntimeError("CUDA error 700: an illegal memory access was encountered")

    monkeypatch.setattr(WarpBatch, "run", broken)
    with pytest.raises(RuntimeError, match="CUDA error 700"):
        sim.losses([[0.5]], make_windows(sim.model, 2, 1), np.ones(2))


@pytest.mark.parametrize(("vectors", "windows"), [(2, 300), (300, 2), (40, 40)])
def test_the_memory_of_a_batch_is_that_of_its_arrays(vectors, windows):
    """Bytes of worlds, rows and windows, found from small batches, add up to those of a large one.

    A mass changes what MuJoCo derives from it, for which each row has a state of its own.
    """
    space = ParameterSpace([Parameter("body_mass", "rod", 0.5, 2.0)])
    sim = WarpSimulator(load(PENDULUM), space, device="warp-cpu", check_influence=False)
    sim.losses(np.linspace(0.6, 1.9, vectors)[:, None], make_windows(sim.model, windows, 3), np.ones(2))
    (sizes, batch), *others = sim._batches.kept.items()
    assert not others
    assert batch._constants is not None
    few, more = (passing_bytes(sim._model, sizes, n, sim.device) for n in (2, 6))
    passing = sizes.nworld * (more - few) / 4
    # a little is the same for all: the model's options, counters
    assert sim.usage().nbytes == pytest.approx(batch.nbytes() + passing, rel=0.01, abs=20_000)


def test_what_fits_at_once():
    """The largest tile of vectors and windows: nothing more fits, and whatever there is, one pair is tried."""
    of = Footprint(world=10, row=100, window=5)
    for memory in (1, 115, 1000, 9999, 10**6):
        for most in ((1, 1), (7, 3), (50, 1000), (10**6, 10**6)):
            n, k = of.tile(memory, *most)
            taken = n * 100 + k * 5 + n * k * 10
            assert (n, k) == (1, 1) or taken <= memory
            assert n == most[0] or (n + 1) * 110 + 5 > memory
            assert k == most[1] or taken + 5 + n * 10 > memory
        assert of.pairs(memory) == max(1, memory // 115)


def test_few_shapes_on_a_gpu():
    """Small calls are filled up to powers of two there: the same answers from one set of buffers."""
    windows = make_windows(load(PENDULUM), 5, 3)
    sim, plain = pendulum(), pendulum()
    sim._rounds = True
    for count in (3, 4):
        xi = np.linspace(0.1, 0.9, count)[:, None]
        np.testing.assert_array_equal(sim.losses(xi, windows, np.ones(2)), plain.losses(xi, windows, np.ones(2)))
        np.testing.assert_array_equal(sim.predict(xi, windows), plain.predict(xi, windows))
    assert sim.usage().nworld == 64
    sim.losses(xi, windows, np.ones(2))
    assert sim.usage().nworld == 4 * 8
    assert (len(sim._batches.kept), len(plain._batches.kept)) == (
        2,
        3,
    )  # losses and predictions, of one shape or of two
