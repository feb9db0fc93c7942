"""Models that collide with themselves where the robot did not: told from what a robot stands on, and by name."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.errors import BadDataset
from nfpde.gap import diagnose_gap
from nfpde.gap.checks import check_fit
from nfpde.gap.overlap import always_touching, without_contacts
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay

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


STANDING = """
<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody>
<geom name="floor" type="plane" size="5 5 .1"/>
<body name="torso" pos="0 0 .1"><freejoint/><geom name="trunk" type="box" size=".2 .2 .1" mass="10"/>
  <body name="neck" pos="0 0 .1"><joint name="yaw" axis="0 1 0" damping=".2"/>
    <geom type="sphere" size=".02" mass=".2" contype="0" conaffinity="0"/>
    <body name="head" pos="0 0 .02"><joint name="nod" axis="1 0 0" damping=".2"/>
      <geom name="sleeve" type="capsule" fromto="0 0 -.06 0 0 .3" size=".03" mass=".3"/></body></body></body>
</worldbody><contact>{contact}</contact>
<actuator><motor joint="yaw"/><motor joint="nod"/></actuator></mujoco>"""


def test_a_robot_that_stands_and_collides_with_itself_is_told_of_that_alone():
    """The floor touches it in every pose, too, and holds it up: without that the model would fall."""
    apart = mujoco.MjModel.from_xml_string(STANDING.format(contact='<exclude body1="torso" body2="head"/>'))
    rng, episodes = np.random.default_rng(0), []
    for number in range(4):
        data, time = mujoco.MjData(apart), 0.01 * np.arange(150)
        mujoco.mj_step(apart, data, 200)
        wish = 0.8 * np.sin(2 * np.pi * rng.uniform(0.5, 2.0, 2) * time[:, None] + rng.uniform(0, 6, 2))
        qpos, qvel, ctrl = np.empty((150, 9)), np.empty((150, 8)), np.empty((150, 2))
        for row in range(150):
            ctrl[row] = wish[row] - 3.0 * data.qpos[-2:]
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            mujoco.mj_step(apart, data, 2)
        episodes.append(Episode(str(number), time, qpos, qvel, ctrl))
    recordings, none = Dataset(episodes), np.zeros(0)
    cut = cut_recordings(recordings, 3, 0, 40)
    check_fit(Replay(apart, None, []), recordings, cut, none)
    nominal = Replay(mujoco.MjModel.from_xml_string(STANDING.format(contact="")), None, [])
    with pytest.raises(BadDataset, match=r"without these contacts\): head and torso\. Exclude"):
        check_fit(nominal, recordings, cut, none)


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


@pytest.mark.parametrize("bits", ["", 'contype="0" conaffinity="0"', 'contype="2" conaffinity="3"'])
def test_without_a_contact_all_others_stay(bits):
    """Of three balls that overlap on a floor, whatever their bits, and though one pair is listed."""
    xml = "".join(
        f'<body name="b{i}" pos="{0.01 * i} 0 .09"><freejoint/><geom name="g{i}" size=".1" {bits}/></body>'
        for i in range(3)
    )
    listed = '<contact><pair geom1="g2" geom2="g0"/></contact>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="plane" size="1 1 1" {bits}/>{xml}</worldbody>{listed}</mujoco>'
    )
    pose = model.qpos0[None]
    every = always_touching(model, pose)
    assert (1, 3) in every
    for gone in ([pair] for pair in every):
        assert always_touching(without_contacts(model, gone), pose) == [pair for pair in every if pair not in gone]
    some = every[1:]
    assert always_touching(without_contacts(model, some), pose) == every[:1]
