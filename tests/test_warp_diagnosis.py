"""The models of the hidden faults on Warp's CPU device, simulated as a diagnosis does, against double precision."""

import numpy as np
import pytest

from nfpde.bench.gap.excite import controller
from nfpde.bench.gap.plant import Plant
from nfpde.bench.gap.record import Noise, episode, start_of
from nfpde.bench.gap.robots import MODELS, ROBOTS
from nfpde.dataset import Dataset, Episode
from nfpde.gap.replay import residual_force
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import load_model
from nfpde.sim.warp import WarpSimulator
from tests.device import WARP
from tests.models import with_arrays

ROWS, HORIZON = 41, 2

# Squared difference of single from double precision as in test_warp, after two control steps of 5 to 20 physics steps.
WORST, MIDDLE = 1e-6, 2e-9

# Where a foot is within rounding of the ground, a step with contact and one without part by 0.1, in double precision as
# well: there the answer must be that of one of so many starts moved by the rounding of single precision.
STARTS, ROUNDING = 12, 1e-7


def recorded(robot):
    """A motion of the robot as the benchmark records it, without noise, cut into windows."""
    rng, plant = np.random.default_rng(0), Plant(robot.path.read_text(), robot.control_dt)
    none = Noise(np.zeros(plant.model.nv), np.zeros(plant.model.nv))
    low, high = plant.model.actuator_ctrlrange.T
    steer, start = controller(robot, low, high, ROWS, rng), start_of(robot, plant.model, rng)
    run = episode(plant, robot, start, steer, ROWS, none, seed=0)
    assert run.stable
    time = robot.control_dt * np.arange(ROWS)
    return Dataset([Episode("0", time, run.qpos, run.qvel, run.ctrl)]).windows(HORIZON, stride=4)


def moved(windows, rng):
    """The same windows from starts that single precision cannot tell from theirs."""
    state = windows.state.copy()
    state[:, 0] += ROUNDING * rng.uniform(-1, 1, state[:, 0].shape)
    return with_arrays(windows, state=state)


def constants(model):
    """Every mass and every damping, from half the model's to twice."""
    masses = [Parameter("body_mass", b, 0.5, 2.0, relative=True) for b in range(1, model.nbody)]
    damped = [j for j in range(model.njnt) if model.dof_damping[model.jnt_dofadr[j]] > 0]
    return ParameterSpace([*masses, *(Parameter("dof_damping", j, 0.5, 2.0, relative=True) for j in damped)])


def test_every_model_is_a_case():
    """No model file without a robot, so that all of them are simulated below."""
    assert {path.stem for path in MODELS.glob("*.xml")} == ROBOTS.keys()


@pytest.mark.parametrize("name", ROBOTS)
def test_agrees_with_mujoco_to_single_precision(name):
    """Predictions and losses with other masses and dampings and a force on every joint; results poisoned beforehand."""
    robot = ROBOTS[name]
    model = load_model(robot.path)
    sim = WarpSimulator(model, constants(model), [residual_force(model)], device=WARP, check_influence=False)
    windows, rng, one = recorded(robot), np.random.default_rng(0), np.ones(sim.states.ndiff)
    xi = np.array(sim.space.uniform(3, rng))
    xi[:, -model.nv :] = rng.uniform(-0.1, 0.1, (3, model.nv))
    starts = [windows, *(moved(windows, rng) for _ in range(STARTS))]
    states = np.array([sim.reference.predict(xi, w) for w in starts])
    expected = np.array([sim.reference.losses(xi, w, one) for w in starts])
    sim.predict(xi, windows)
    sim.losses(xi, windows, one)
    for batch in sim._batches.kept.values():
        batch.poison()
    square = (sim.states.difference(sim.predict(xi, windows), states) ** 2).sum((-1, -2)).min(0)
    assert square.max() < WORST
    assert np.median(square) < MIDDLE
    # |a|^2 - |b|^2 is at most |a-b| (2|b| + |a-b|)
    root = np.sqrt(WORST)
    assert (np.abs(sim.losses(xi, windows, one) - expected) < root * (2 * np.sqrt(expected) + root)).any(0).all()
