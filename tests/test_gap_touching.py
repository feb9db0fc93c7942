"""Joints that touch nothing with what they carry: which they are, and that residuals can be theirs alone."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nfpde.gap.fit import Fitter
from nfpde.gap.loud import Loudness
from nfpde.gap.noise import learn_scatter
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.touching import STATES, free_dofs, touches
from nfpde.gap.trial import noise_of
from tests.gap_systems import nominal, record

SLED = """
<mujoco>
<worldbody>
  <geom type="plane" size="5 5 .1"/>
  <body name="block" pos="0 0 .05">
    <joint name="along" type="slide" axis="1 0 0"/><joint name="up" type="slide" axis="0 0 1"/>
    <geom type="box" size=".1 .1 .05" mass="2"/>
    <body name="whip" pos="0 0 .05"><joint name="swing" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 .05 0 0 .3" size=".01" mass=".3"/></body>
    <body name="leg" pos=".1 0 0"><joint name="hip" axis="0 1 0"/>
      <geom type="capsule" fromto=".05 0 0 .1 0 0" size=".01" mass=".1"/>
      <body name="sole" pos=".15 0 0"><geom type="sphere" size=".02" mass=".05"/></body></body>
  </body>
</worldbody></mujoco>
"""
"""Along, up, swing, hip: a block that carries a whip and a leg, the sole of which is no joint of its own."""


def test_what_touches_presses_on_all_joints_above_it_and_on_no_other():
    model = mujoco.MjModel.from_xml_string(SLED)
    above, on, kneeling = np.zeros((3, 8))
    above[1], on[1], kneeling[3] = 0.2, -0.001, 0.3  # the hip turns the sole down
    kneeling[1] = 0.01
    assert free_dofs(model, above[None]).tolist() == [0, 1, 2, 3]
    assert free_dofs(model, on[None]).tolist() == [2, 3]
    assert free_dofs(model, kneeling[None]).tolist() == [2]
    # one touch in all recordings is enough, and what was not recorded says nothing
    assert free_dofs(model, np.vstack([np.tile(above, (50, 1)), on, np.full(8, np.nan)])).tolist() == [2, 3]


BALL = """
<mujoco><worldbody>
  <body name="lever" pos="0 0 .3"><joint name="pivot" axis="0 -1 0"/>
    <geom type="capsule" fromto="0 0 0 .36 0 0" size=".012" mass=".35"/></body>
  <body name="ball" pos=".3 0 .4"><joint name="fall" type="slide" axis="0 0 1"/>
    <geom type="sphere" size=".03" mass=".12"/></body>
</worldbody><actuator><position joint="pivot" kp="45" kv="1.5"/></actuator></mujoco>
"""


def test_what_touches_another_part_of_the_robot_touches():
    """A ball on a lever: nothing meets the world, which alone has a friction and a softness to be wrong."""
    model = mujoco.MjModel.from_xml_string(BALL)
    above, on = np.zeros((2, 4))
    on[1] = -0.06
    assert not touches(model, above[None])
    assert touches(model, np.vstack([np.tile(above, (50, 1)), on]))


def test_long_recordings_are_looked_at_all_along():
    model = mujoco.MjModel.from_xml_string(SLED)
    states = np.tile([0, 0.2, 0, 0, 0, 0, 0, 0.0], (5 * STATES, 1))
    states[-20:, 1] = -0.001
    assert free_dofs(model, states).tolist() == [2, 3]


def test_what_is_flexible_may_hang_on_any_body():
    cloth = """<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
      <body><joint name="spin" axis="0 0 1"/><geom type="sphere" size=".01" pos="0 0 3"/></body>
      <flexcomp type="grid" count="3 3 1" spacing=".1 .1 .1" pos="0 0 {height}" radius=".01" name="cloth" dim="2">
        <contact selfcollide="none"/></flexcomp></worldbody></mujoco>"""
    on, above = (mujoco.MjModel.from_xml_string(cloth.format(height=h)) for h in (0.005, 1.0))
    assert free_dofs(on, np.concatenate([on.qpos0, np.zeros(on.nv)])[None]).tolist() == []
    assert 0 in free_dofs(above, np.concatenate([above.qpos0, np.zeros(above.nv)])[None])


@pytest.mark.parametrize("dof", [0, 1])
def test_residuals_of_a_part_of_the_joints_are_those_of_all_without_the_others(dof):
    """So are what noise gives and by how much channels move, and what they are counted in is cut with them."""
    cut = cut_recordings(record(force=lambda data: 0.1, noise=1e-3), 0, 0, 40)
    replay = Replay(nominal(), None, [])
    every = Fitter(cut.fit, cut.horizons)
    part = replace(every, dofs=np.array([dof]))
    at = np.zeros((1, 0))
    left = every.residuals_at(replay, at)
    assert np.array_equal(part.residuals_at(replay, at), left[:, :, dof : dof + 1])
    assert np.array_equal(part.moved(replay), every.moved(replay)[:, dof : dof + 1])
    scatter = learn_scatter(left[0], 0, np.ones(left.shape[2:]))
    fit, sigma = every.start(replay, at, scatter), np.array([1e-3, 2e-3, 3e-3, 4e-3])
    noise = noise_of(fit, sigma, every, 3)
    assert np.array_equal(noise_of(fit, sigma, part, 3), noise[:, :, dof : dof + 1])
    loud = replace(part, noise=Loudness(2.0 * np.ones((len(cut.fit), 1, left.shape[3]))))
    few = loud.some(np.arange(5))
    assert np.array_equal(few.residuals_at(replay, at), left[:, :5, dof : dof + 1] / 2)
