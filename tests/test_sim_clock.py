"""Time is in seconds: what positions and speeds say of it."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.errors import BadDataset
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator
from tests.gap_systems import nominal, record

SPACE = ParameterSpace([Parameter("dof_damping", "elbow", 0.01, 0.1)])


def counted(dataset, factor):
    """The recordings of a clock that counts in other units."""
    return Dataset([Episode(e.name, factor * e.time, e.qpos, e.qvel, e.ctrl) for e in dataset])


@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_other_clocks_are_named(factor, unit, noise):
    """Milli-, micro- and nanoseconds, of which a control step would be thousands of physics steps and more."""
    sim = MujocoSimulator(nominal(), SPACE)
    data = record(noise=noise, episodes=2)
    assert sim.prepare(data) is data
    with pytest.raises(BadDataset, match=f"time looks recorded in {unit}: .* Multiply time by {1 / factor:g};"):
        sim.prepare(counted(data, factor))


def test_one_sound_joint_speaks_for_the_clock():
    """Speeds of one joint in other units are not the clock's."""
    sim = MujocoSimulator(nominal(), SPACE)
    data = record(episodes=2)
    wrong = Dataset([Episode(e.name, e.time, e.qpos, e.qvel * [1.0, 1e3], e.ctrl) for e in data])
    assert sim.prepare(wrong) is wrong


def test_recordings_that_say_nothing_of_the_clock_pass():
    """At rest with noisy sensors, and of bodies that only turn."""
    rng = np.random.default_rng(0)
    time = np.arange(200.0)
    rest = Dataset(
        [Episode("0", time, 1e-3 * rng.normal(size=(200, 2)), rng.normal(size=(200, 2)), np.zeros((200, 2)))]
    )
    assert MujocoSimulator(nominal(), SPACE).prepare(rest) is rest
    ball = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="b"><joint name="j" type="ball"/><geom size=".1"/></body></worldbody></mujoco>'
    )
    turned = Dataset([Episode("0", time, np.tile([1.0, 0, 0, 0], (200, 1)), np.zeros((200, 3)), np.zeros((200, 0)))])
    sim = MujocoSimulator(ball, ParameterSpace([Parameter("body_mass", "b", 1.0, 9.0)]), check_influence=False)
    assert sim.prepare(turned) is turned
