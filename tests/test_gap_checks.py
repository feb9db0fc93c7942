"""Models that collide with themselves where the robot did not, and what a verdict makes of an uncertain floor."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.errors import BadDataset, SimulationDiverged
from nfpde.gap import diagnose_gap
from nfpde.gap.answer import NEAR_FLOOR, _verdict
from nfpde.gap.overlap import always_touching, without_contacts
from nfpde.gap.report import Level
from tests.gap_systems import ARM, nominal, record

LEG = """
<mujoco><option timestep="0.005" integrator="implicitfast"/>
<worldbody><body name="trunk" pos="0 0 1"><geom type="box" size=".1 .1 .1" mass="2"/>
  <body name="leg"><joint name="hip" axis="0 1 0" damping=".1"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1"/></body></body></worldbody>
<actuator><motor name="hip" joint="hip"/></actuator>{contact}</mujoco>
"""
EXCLUDED = '<contact><exclude body1="trunk" body2="leg"/></contact>'


def leg(contact=""):
    return mujoco.MjModel.from_xml_string(LEG.format(contact=contact))


def swing(rows=250, episodes=4):
    """A leg that swings freely under a sine, recorded on the model that leaves the overlap alone."""
    out = []
    for number in range(episodes):
        model = leg(EXCLUDED)
        data = mujoco.MjData(model)
        ctrl = 0.8 * np.sin(2 * np.pi * (0.6 + 0.3 * number) * 0.01 * np.arange(rows))[:, None]
        qpos, qvel = np.empty((rows, 1)), np.empty((rows, 1))
        for row in range(rows):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            mujoco.mj_step(model, data, 2)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, ctrl))
    return Dataset(out)


def test_a_leg_that_starts_inside_the_trunk_is_named():
    """A trunk fixed to the world no longer ignores its child: the text names both bodies and how to exclude them."""
    data = swing()
    with pytest.raises(BadDataset, match=r"geoms overlap.*leg and trunk.*<exclude body1= body2=>"):
        diagnose_gap(leg(), data, windows=40)
    assert diagnose_gap(leg(EXCLUDED), data, windows=40).verdict == "no_gap"


ODD = np.array([1.0, -1.0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda q, v, u: (q * ODD, v * ODD, u * ODD), "elbow's sign looks flipped \\("),
        (lambda q, v, u: (q * ODD, v * ODD, u), "elbow's sign looks flipped in qpos and qvel"),
        (lambda q, v, u: (q, v, u * ODD), "elbow's sign looks flipped in the commands"),
        (lambda q, v, u: (q[:, ::-1], v[:, ::-1], u[:, ::-1]), "shoulder and elbow look swapped \\("),
        (lambda q, v, u: (q[:, ::-1], v[:, ::-1], u), "shoulder and elbow look swapped in qpos and qvel"),
        (lambda q, v, u: (q, v, u[:, ::-1]), "shoulder and elbow look swapped in the commands"),
    ],
)
def test_signs_and_columns_are_named(change, words):
    """States, commands or both of a joint with the wrong sign or in the wrong column: the text says which."""
    wrong = [Episode(e.name, e.time, *change(e.qpos, e.qvel, e.ctrl)) for e in record(noise=1e-3)]
    with pytest.raises(BadDataset, match=words):
        diagnose_gap(nominal(), Dataset(wrong))


def test_a_model_that_diverges_is_refused():
    """Springs that push until the simulation blows up: the text says what to try, and no warning escapes."""
    wild = mujoco.MjModel.from_xml_string(ARM.replace('damping="0.05"', 'stiffness="-40000"'))
    with pytest.raises(SimulationDiverged, match=r"diverges from most recorded states.*halve its timestep"):
        diagnose_gap(wild, record())


def test_velocities_that_nobody_recorded_are_missed():
    """Positions that change beside velocities of zero cannot be a robot's."""
    data = Dataset([Episode(e.name, e.time, e.qpos, 0 * e.qvel, e.ctrl) for e in record()])
    with pytest.raises(BadDataset, match="shoulder: its qpos changes while its qvel stands still at 0"):
        diagnose_gap(nominal(), data)


def test_only_what_touches_in_every_pose_is_listed():
    """A pair counts where it touches in all poses, not where it does in some; without its geom it does in none."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
        <body><joint type="slide" axis="0 0 1"/><geom size=".1"/></body></worldbody></mujoco>"""
    )
    low, high = np.array([[0.05], [0.09]]), np.array([[0.05], [0.5]])
    assert always_touching(model, low) == [(0, 1)]
    assert always_touching(model, high) == []
    assert always_touching(without_contacts(model, [(0, 1)]), low) == []
    assert model.geom_contype[1] == 1


@pytest.mark.parametrize(
    ("over", "named", "verdict"),
    [
        (0.9 * NEAR_FLOOR, False, "no_gap"),
        (0.9 * NEAR_FLOOR, True, "effects"),
        (1.1 * NEAR_FLOOR, False, "unexplained"),
        (1.1 * NEAR_FLOOR, True, "unexplained"),
    ],
)
def test_only_a_gap_surely_above_the_floor_is_unexplained(over, named, verdict):
    """The lower end of the ratio's interval decides, with three floors left at the estimate itself."""
    assert _verdict(Level(1.0, 0.9, 0.3, 0.1), over, 1.0, named=named) == verdict


def test_a_few_windows_far_beyond_all_noise_are_a_gap():
    """Where the mean is at the floor and nothing is named, windows that noise cannot explain are left unexplained."""
    assert _verdict(Level(1.0, 0.9, 0.3, 0.3), 1.0, 1e-6, named=False) == "unexplained"
    assert _verdict(Level(1.0, 0.9, 0.3, 0.3), 1.0, 1e-6, named=True) == "effects"


def test_most_of_a_gap_explained_is_explained():
    """Nine tenths of what there was beyond noise suffice for effects, whatever the rest is worth in noise."""
    assert _verdict(Level(1.0, 0.9, 0.05, 0.001), 50.0, 1.0, named=True) == "effects"
    assert _verdict(Level(1.0, 0.9, 0.05, 0.001), 50.0, 1.0, named=True, sound=False) == "unexplained"
    assert _verdict(Level(1.0, 0.9, 0.2, 0.001), 50.0, 1.0, named=True) == "unexplained"
