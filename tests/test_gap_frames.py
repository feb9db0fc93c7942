"""Free joints and balls recorded in other conventions than MuJoCo's."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.errors import BadDataset
from nfpde.gap.frames import check_frames

BOX = """
<mujoco><option timestep="0.002"/><worldbody><body name="box" pos="0 0 1">{joint}
  <geom type="box" size=".1 .2 .05" mass="1"/></body></worldbody></mujoco>
"""
FREE = mujoco.MjModel.from_xml_string(BOX.format(joint='<freejoint name="root"/>'))
BALL = mujoco.MjModel.from_xml_string(BOX.format(joint='<joint name="root" type="ball" pos="0 0 .3"/>'))


def tumble(model, noise=1e-3, spin=3.0, rows=150, episodes=3, seed=0):
    """A box thrown into the air, or swinging, its readings noisy."""
    rng, out = np.random.default_rng(seed), []
    for number in range(episodes):
        data = mujoco.MjData(model)
        data.qvel[:] = spin * rng.normal(size=model.nv)
        qpos, qvel = np.empty((rows, model.nq)), np.empty((rows, model.nv))
        for row in range(rows):
            qpos[row], qvel[row] = data.qpos, data.qvel + noise * rng.normal(size=model.nv)
            mujoco.mj_integratePos(model, qpos[row], noise * rng.normal(size=model.nv), 1.0)
            mujoco.mj_step(model, data, 5)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, np.empty((rows, 0))))
    return Dataset(out)


def changed(data, change):
    """Every row through a function of (qpos, qvel, rotation matrix of the body)."""
    out = []
    for e in data:
        qpos, qvel, turn = e.qpos.copy(), e.qvel.copy(), np.empty(9)
        for row in range(len(e)):
            mujoco.mju_quat2Mat(turn, e.qpos[row, -4:])
            change(qpos[row], qvel[row], turn.reshape(3, 3))
        out.append(Episode(e.name, e.time, qpos, qvel, e.ctrl))
    return Dataset(out)


def last(qpos, qvel, turn):
    """The quaternion's w in the last place."""
    qpos[-4:] = np.roll(qpos[-4:], -1)


def world(qpos, qvel, turn):
    """The angular velocity in the world's frame."""
    qvel[-3:] = turn @ qvel[-3:]


def body(qpos, qvel, turn):
    """The linear velocity in the body's frame."""
    qvel[:3] = turn.T @ qvel[:3]


def both(qpos, qvel, turn):
    """The quaternion and the angular velocity."""
    world(qpos, qvel, turn)
    last(qpos, qvel, turn)


@pytest.mark.parametrize(
    ("model", "change", "words"),
    [
        (FREE, last, "root: its quaternions look recorded as x, y, z, w.*roll every quaternion"),
        (FREE, world, "root: its angular velocity looks recorded in the world's frame.*transpose"),
        (FREE, body, "root: its linear velocity looks recorded in the body's frame.*by the body's rotation matrix"),
        (FREE, both, "x, y, z, w.* and its angular velocity looks recorded in the world's frame"),
        (BALL, last, "root: its quaternions look recorded as x, y, z, w"),
        (BALL, world, "root: its angular velocity looks recorded in the world's frame"),
    ],
)
def test_other_conventions_are_named(model, change, words):
    """As ROS and most motion capture write them, with what to do; the same readings in MuJoCo's own pass."""
    data = tumble(model)
    check_frames(model, data)
    with pytest.raises(BadDataset, match=words):
        check_frames(model, changed(data, change))


@pytest.mark.parametrize("model", [FREE, BALL], ids=["free", "ball"])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.1])
@pytest.mark.parametrize("spin", [0.0, 1e-4, 3.0])
def test_sound_readings_pass(model, noise, spin):
    """At rest and in motion, with noise that drowns the motion too: from that no convention can be told."""
    for seed in range(5):
        check_frames(model, tumble(model, noise, spin, rows=40, seed=seed))


def test_a_turn_about_one_axis_tells_no_frame():
    """About a vertical axis the body's and the world's angular velocity are the same: nothing is refused."""
    time = 0.01 * np.arange(100)
    qpos, qvel = np.zeros((100, 7)), np.zeros((100, 6))
    qpos[:, 3], qpos[:, 6], qvel[:, 5] = np.cos(time), np.sin(time), 2.0
    data = Dataset([Episode("0", time, qpos, qvel, np.empty((100, 0)))])
    check_frames(FREE, data)
    check_frames(FREE, changed(data, world))
