"""Which regime a window counts to: known motions, contacts and commands, and shares that add up."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode, Windows
from nfpde.gap import diagnose_gap
from nfpde.gap.regimes import questions
from nfpde.gap.report import GapMap
from nfpde.gap.where import gap_map, places

HOPPER = """
<mujoco><option timestep="0.002" integrator="implicitfast"/>
<worldbody>
  <geom name="floor" type="plane" size="5 5 .1"/>
  <body name="trunk" pos="0 0 1"><joint name="height" type="slide" axis="0 0 1"/>
    <geom type="box" size=".1 .1 .1" mass="3"/>
    <body name="arm" pos="0 .2 0"><joint name="swing" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/>
    </body>
    <body name="foot" pos="0 0 -.5"><joint name="leg" type="slide" axis="0 0 1" stiffness="900" damping="4"
      range="-.3 .3"/><geom name="sole" type="sphere" size=".05" mass=".2"/></body></body>
</worldbody>
<actuator><motor name="push" joint="leg" gear="100" ctrlrange="-1 1"/>
  <position name="wave" joint="swing" kp="20" kv="1" forcerange="-.5 .5"/></actuator></mujoco>
"""


@pytest.fixture(scope="module")
def hopper():
    return mujoco.MjModel.from_xml_string(HOPPER)


def windows_of(model, qpos, qvel=None, ctrl=None, steps=4):
    """One episode of given positions (rows, nq), cut into windows of a few steps."""
    qpos = np.asarray(qpos, dtype=float)
    rows = len(qpos)
    qvel = np.zeros((rows, model.nv)) if qvel is None else qvel
    ctrl = np.zeros((rows, model.nu)) if ctrl is None else ctrl
    return Dataset([Episode("0", 0.01 * np.arange(rows), qpos, qvel, ctrl)]).windows(steps)


def asked(model, windows):
    return {q.name: q for q in questions(model, windows)}


def answers(question, joint):
    return [question.answers[i] for i in question.of[:, joint]]


def test_contact_is_that_of_what_the_joint_carries(hopper):
    """A foot on the floor is a contact of trunk and leg, but not of the arm that swings freely above."""
    high, low = 0.0, -0.46  # the sole's lower end is 0.45 m above the floor at 0
    height = np.repeat([high, low, high, low], [5, 4, 2, 2])
    qpos = np.zeros((len(height), 3))
    qpos[:, 0] = height
    windows = windows_of(hopper, qpos)
    contact = asked(hopper, windows)["contact"]
    expected = ["in flight", "in contact" if (height[4:9] < 0).all() else "contact changes", "contact changes"]
    assert answers(contact, 0) == answers(contact, 2) == expected[: len(windows)]
    assert set(answers(contact, 1)) == {"in flight"}


def test_contact_is_not_asked_where_nothing_touches(hopper):
    """A robot in the air all the time has one column less to read."""
    assert "contact" not in asked(hopper, windows_of(hopper, np.zeros((13, 3))))


def test_commands_and_forces_at_their_ends_saturate(hopper):
    """A motor at the end of its command range, a servo at the end of its force range: their joints only."""
    ctrl = np.zeros((13, 2))
    ctrl[:4, 0] = 1.0  # the range is -1 to 1
    ctrl[4:8, 1] = 0.1  # 20 * 0.1 Nm, clipped to 0.5 Nm
    windows = windows_of(hopper, np.zeros((13, 3)), ctrl=ctrl)
    command = asked(hopper, windows)["command"]
    assert answers(command, 2) == ["saturated", "within limits", "within limits"]
    assert answers(command, 1) == ["within limits", "saturated", "within limits"]
    assert set(answers(command, 0)) == {"within limits"}


def test_motion_of_each_kind(hopper):
    """A joint at rest, in slow and in fast motion one way, and one that turns round."""
    speed = np.zeros((17, 3))
    speed[:, 1] = np.repeat([0.0, 0.5, 4.0, 4.0, -4.0], [4, 4, 4, 3, 2])
    motion = asked(hopper, windows_of(hopper, np.zeros((17, 3)), speed))["motion"]
    assert answers(motion, 1)[1:] == ["slow", "fast", "reversal"]
    assert set(answers(motion, 0)) == {"rest"}


def test_early_and_late_are_halves_of_each_episode(hopper):
    """Five windows in a row: those up to the middle are early."""
    time = asked(hopper, windows_of(hopper, np.zeros((21, 3))))["time"]
    assert answers(time, 0) == ["early", "early", "early", "late", "late"]


def test_every_question_splits_the_same_whole(hopper):
    """Each group of the map sums to 1, and each joint's share is the same in all of them."""
    rng = np.random.default_rng(0)
    qpos = np.zeros((201, 3))
    qpos[:, 0] = np.where(np.arange(201) % 23 < 9, -0.46, 0.0)
    windows = windows_of(hopper, qpos, 0.1 * rng.normal(size=(201, 3)))
    energy = rng.normal(size=(50, 3)) + np.array([0.1, 1.0, 3.0])
    found = gap_map(hopper, windows, energy)
    assert list(found.groups) == ["motion", "contact", "time"]
    for group in found.groups:
        assert found.part(group).sum() == pytest.approx(1.0)
        np.testing.assert_allclose(found.part(group).sum(1), found.part("motion").sum(1), rtol=1e-12)
        assert (found.part(group) >= 0).all()
    assert (found.windows.sum(1) == 3 * 50).all()
    assert sum(p.share for p in places(found)) == pytest.approx(1.0)


def test_the_regime_named_is_the_one_singled_out():
    """Half of the gap in a tenth of the windows says more than half of it in half of them."""
    share = np.array([[0.2, 0.3, 0.3, 0.2, 0.5, 0.5, 0.5, 0.5]])
    windows = np.array([[20, 30, 30, 20, 10, 90, 50, 50]])
    regimes = ("rest", "reversal", "slow", "fast", "in contact", "in flight", "early", "late")
    found = GapMap(["leg"], regimes, share, windows, {"motion": 4, "contact": 2, "time": 2})
    assert [(p.joint, p.regime) for p in places(found)] == [("leg", "in contact")]


def test_where_no_regime_is_singled_out_it_is_how_the_joint_moves():
    """Half of the gap in half of the windows is no news, and a little more is none either."""
    share = np.array([[0.0, 0.95, 0.05, 0.0, 0.52, 0.48]])
    windows = np.array([[0, 95, 5, 0, 50, 50]])
    regimes = ("rest", "reversal", "slow", "fast", "early", "late")
    found = GapMap(["leg"], regimes, share, windows, {"motion": 4, "time": 2})
    assert [p.regime for p in places(found)] == ["reversal"]


def hop(push, episodes=6, rows=300, seed=0):
    """Episodes of the hopper driven by sines, with a force on its leg while its foot stands."""
    rng = np.random.default_rng(seed)
    out = []
    for number in range(episodes):
        model = mujoco.MjModel.from_xml_string(HOPPER)
        data = mujoco.MjData(model)
        rate, phase = rng.uniform(1.5, 3.0, 2), rng.uniform(0, 6, 2)
        time = 0.01 * np.arange(rows)
        ctrl = np.stack([0.6 * np.sin(2 * np.pi * r * time + p) for r, p in zip(rate, phase, strict=True)], axis=1)
        qpos, qvel = np.empty((rows, 3)), np.empty((rows, 3))
        for row in range(rows):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            for _ in range(5):
                data.qfrc_applied[2] = push * (data.ncon > 0)
                mujoco.mj_step(model, data)
        out.append(Episode(str(number), time, qpos, qvel, ctrl))
    return Dataset(out)


def test_a_fault_on_the_floor_is_placed_in_contact(tmp_path):
    """A force on the leg that acts only while the foot stands: the map and the answer for machines say so."""
    found = diagnose_gap(mujoco.MjModel.from_xml_string(HOPPER), hop(-15.0), windows=60)
    contact = found.gap_map.part("contact").sum(0)
    assert contact[:2].sum() > 0.9
    told = json.loads(found.save(tmp_path).read_text())["gap_map"]
    for group in ("motion", "contact", "time"):
        assert sum(v for row in told[group].values() for v in row.values()) == pytest.approx(1.0)
    empty = replace(found.gap_map, share=0 * found.gap_map.share)
    assert sum(p.share for p in places(empty)) == 0.0


def test_a_body_that_goes_one_way_turns_round_nowhere():
    """A rover that backs off while it yaws to the left has speeds of both signs, and none of them changes."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint name='root'/><geom size='.1'/></body></worldbody></mujoco>"
    )
    qvel = np.tile([-0.5, 0, 0, 0, 0, 0.3], (9, 1))
    steady = asked(model, windows_of(model, np.tile(model.qpos0, (9, 1)), qvel))["motion"]
    assert set(answers(steady, 0)) == {"fast"}
    qvel[2, 5] = -0.3
    swaying = asked(model, windows_of(model, np.tile(model.qpos0, (9, 1)), qvel))["motion"]
    assert answers(swaying, 0) == ["reversal", "fast"]


def test_metres_and_radians_of_a_body_count_each_in_their_own():
    """One that goes straight on at 0.6 m/s, and then spins at 15 rad/s, rests in neither."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint name='root'/><geom size='.1'/></body></worldbody></mujoco>"
    )
    qvel = np.zeros((17, 6))
    qvel[:5, 0], qvel[5:9, 5], qvel[9:, 0] = 0.6, 15.0, 0.01
    windows = windows_of(model, np.tile(model.qpos0, (17, 1)), qvel)
    for millimetres in (False, True):
        state = windows.state.copy()
        state[:, :, 7:10] *= 1000 if millimetres else 1
        motion = asked(model, replace(windows, state=state))["motion"]
        assert [answers(motion, 0)[i] for i in (0, 1, 3)] == ["fast", "fast", "rest"]


CLOTH = """
<mujoco><worldbody><geom name="floor" type="plane" size="2 2 .1"/>
<flexcomp name="c" type="grid" count="3 3 1" spacing=".1 .1 .1" pos="0 0 .02" radius=".03" dim="2" mass=".1">
  <contact selfcollide="none"/><edge equality="true"/></flexcomp>
<body pos="1 0 2"><joint name="arm" axis="0 1 0"/>
  <geom name="arm" type="capsule" fromto="0 0 0 .3 0 0" size=".02"/></body></worldbody></mujoco>
"""


@pytest.mark.parametrize("ball", ["", '<body pos="0 0 .06"><freejoint/><geom name="ball" size=".04"/></body>'])
def test_what_is_flexible_touches_where_it_hangs(ball):
    """A cloth on the floor is no contact of the arm two metres above it, whose geom comes last."""
    model = mujoco.MjModel.from_xml_string(CLOTH.replace('<body pos="1', ball + '<body pos="1'))
    state = np.tile(np.hstack([model.qpos0, np.zeros(model.nv)]), (6, 3, 1))
    state[:3, :, 2:27:3] += 1.0  # the cloth's vertices slide along x, y and z
    nothing = np.empty((6, 0, model.nu))
    windows = Windows(
        state, np.zeros((6, 2, model.nu)), nothing, 0.01, model.nq, model.nv, np.zeros(6, int), np.arange(6)
    )
    contact = asked(model, windows)["contact"]
    assert set(answers(contact, model.joint("arm").id)) == {"in flight"}
    assert answers(contact, 2) == ["in flight"] * 3 + ["in contact"] * 3
    if ball:  # it lies in the cloth
        assert answers(contact, int(model.body_jntadr[model.geom("ball").bodyid[0]]))[3:] == ["in contact"] * 3
