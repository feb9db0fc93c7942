"""Columns by name, and elements by "*": simulators take what users call things."""

import re
import tracemalloc

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfpde.dataset import ColumnNames, Dataset, Episode
from nfpde.effects import effect
from nfpde.errors import BadDataset, BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import CallableSimulator, MujocoSimulator
from nfpde.sim.simulator import CHUNK_NUMBERS
from tests.models import DOUBLE_PENDULUM, FREE_BOX, load, make_windows

ANY = ParameterSpace([Parameter("gain", low=0.0, high=1.0)])
FLOORED = """<mujoco><option timestep="0.002"/><worldbody>
<geom name="floor" type="plane" size="5 5 .1" friction="{} .005 .0001"/>
<body name="b" pos="0 0 .1"><joint type="slide" axis="1 0 0" name="x"/><joint type="slide" axis="0 0 1" name="z"/>
<geom name="foot" size=".1 .1 .1" type="box" mass="1" friction=".6 .005 .0001"/></body></worldbody>
<actuator><motor joint="x" gear="5"/></actuator></mujoco>"""


def swapped(**names):
    """Recordings whose columns stand in the order b, a and u2, u1."""
    columns = np.array([[100.0, 0.0], [101.0, 1.0]])
    return Dataset(
        [Episode("0", [0, 0.1], columns, 10 * columns, -columns)],
        column_names=ColumnNames(**({"qpos": ("b", "a"), "qvel": ("b", "a"), "ctrl": ("u2", "u1")} | names)),
    )


def test_a_function_gets_the_columns_that_it_names():
    """Whatever their order in the file; commands without names stay as they are."""
    sim = CallableSimulator(lambda x, u, xi: x, ANY, ["a", "b"], ["a", "b"], ["u1", "u2"])
    found = sim.prepare(swapped())[0]
    assert_array_equal(found.qpos, [[0, 100], [1, 101]])
    assert_array_equal(found.qvel, [[0, 1000], [10, 1010]])
    assert_array_equal(found.ctrl, [[0, -100], [-1, -101]])
    unnamed = CallableSimulator(lambda x, u, xi: x, ANY, ["a", "b"], ["a", "b"])
    assert_array_equal(unnamed.prepare(swapped())[0].qpos, [[0, 100], [1, 101]])
    assert_array_equal(unnamed.prepare(swapped())[0].ctrl, swapped()[0].ctrl)
    numbered = Dataset([swapped()[0]])
    assert sim.prepare(numbered) is numbered


def test_names_that_a_function_lacks_are_refused():
    sim = CallableSimulator(lambda x, u, xi: x, ANY, ["a", "b"], ["a", "b"], ["u1", "u2"])
    with pytest.raises(BadDataset, match=re.escape("the data names qpos column(s) x, y that the model does not have")):
        sim.prepare(swapped(qpos=("x", "y")))


@pytest.mark.parametrize("frictions", [("2.0", "0.1"), ("0.1", "2.0")])
@pytest.mark.parametrize("first", [True, False])
def test_a_parameter_that_matters_in_one_of_several_models(frictions, first):
    """In whatever order models and parameters are: the foot is rougher than one of two floors only."""
    models = [load(FLOORED.format(f)) for f in frictions]
    foot, which = Parameter("geom_friction", "foot", 0.3, 1.0), Parameter("model", low=0, high=2)
    MujocoSimulator(models, ParameterSpace([foot, which] if first else [which, foot]))
    with pytest.raises(BadParameter, match=r"geom_friction:foot .* changes nothing"):
        MujocoSimulator([models[frictions.index("2.0")]] * 2, ParameterSpace([foot, which]), check_influence=True)


def test_all_masses_are_those_of_all_bodies_but_the_world():
    """Twice the masses and inertias everywhere: a free box falls as before, and pushes twice as hard."""
    model = load(DOUBLE_PENDULUM)
    sim = MujocoSimulator(model, ParameterSpace([Parameter("body_mass", "*", 0.5, 2.0, relative=True)]))
    heavy = load(DOUBLE_PENDULUM)
    heavy.body_mass *= 1.7
    heavy.body_inertia *= 1.7
    mujoco.mj_setConst(heavy, mujoco.MjData(heavy))
    same = MujocoSimulator(heavy, ParameterSpace([Parameter("body_mass", "upper", 0.1, 9.0)]), check_influence=False)
    windows = make_windows(model, 5, 20)
    assert_allclose(sim.predict([[1.7]], windows), same.predict([[heavy.body("upper").mass[0]]], windows), rtol=1e-9)


def test_what_is_zero_stays_so_where_others_are_scaled():
    """Dampings of a free box in the air and of what hangs on it; a model with none is refused."""
    hung = FREE_BOX.replace("</body>", '<body><joint name="k" damping=".5"/><geom size=".1"/></body></body>', 1)
    space = ParameterSpace([Parameter("dof_damping", "*", 0.5, 2.0, relative=True)])
    sim = MujocoSimulator(load(hung), space)
    assert_array_equal(sim.writer.rows(np.array([[2.0]]))["dof_damping"], [[0, 0, 0, 0, 0, 0, 1.0]])
    with pytest.raises(BadParameter, match="own value is 0, so it cannot be scaled"):
        MujocoSimulator(load(FREE_BOX), space)


def test_commands_from_before_a_window_are_counted():
    """A slow lag at 500 Hz, in windows of one step: few copies of what is allowed at once, not of all rows."""
    model = load(DOUBLE_PENDULUM)
    lag = effect("actuator_lag", "*", time_constant=(0.0, 4.0))
    sim = MujocoSimulator(model, None, [lag], check_influence=False, nthread=1)
    windows = make_windows(model, 4, 1, history=sim.history_steps(model.opt.timestep))
    constants = np.linspace(0.01, 4.0, 500)[:, None]
    assert windows.history[0].size * 4 * len(constants) > 3 * CHUNK_NUMBERS
    tracemalloc.start()
    sim.predict(constants, windows)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 6 * 8 * CHUNK_NUMBERS
