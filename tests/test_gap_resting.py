"""Encoders of joints that rest: what they err by is found, and is no fault of the robot."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.errors import SimulationDiverged
from nfpde.gap import diagnose_gap
from nfpde.gap.grain import Encoders
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.resting import ReadingOffset, resting_error, without_error
from nfpde.parameters import Parameter, ParameterSpace
from tests.test_gap_contacts import BLOCK, pushes

GRAIN, ZERO = 8e-4, 0.3
"""Step of the encoder [m], and where its steps lie, in steps."""


def read_coarsely(data, noise=1e-4):
    """The block's height by an encoder, everything else with noise; and by how much it reads too high on average."""
    rng, out, errors = np.random.default_rng(5), [], []
    for episode in data:
        qpos = episode.qpos + noise * rng.normal(size=episode.qpos.shape)
        qpos[:, 1] = GRAIN * (np.round(episode.qpos[:, 1] / GRAIN - ZERO) + ZERO)
        errors.append(qpos[:, 1] - episode.qpos[:, 1])
        out.append(replace(episode, qpos=qpos, qvel=episode.qvel + noise * rng.normal(size=episode.qvel.shape)))
    return Dataset(out), float(np.mean(np.concatenate(errors)))


def encoders(episodes):
    """What recordings tell of them."""
    return Encoders.of([np.hstack([e.qpos, e.qvel]) for e in episodes])


def test_joints_that_rest_are_told_from_those_that_move():
    """One reading in most rows, however the rest is spread; never a joint that is read anew in every row."""
    data, _ = read_coarsely(pushes(0.5, noise=0.0))
    model = mujoco.MjModel.from_xml_string(BLOCK)
    assert encoders(data).resting(model).tolist() == [False, True]
    for share, rests in ((0.4, True), (0.6, False)):
        moved = [replace(e, qpos=e.qpos + GRAIN * _some(e.qpos, share)) for e in data]
        assert encoders(moved).resting(model).tolist() == [False, rests]


def _some(qpos, share):
    """Whole steps, another in every row, of a share of the rows in the second column."""
    rows = len(qpos)
    return np.column_stack([np.zeros(rows), np.where(np.arange(rows) < share * rows, 1 + np.arange(rows), 0)])


def test_the_error_of_an_encoder_at_rest_is_found():
    """A quarter of a millimetre, told by what the floor carries; moving the recordings takes it out of them."""
    data, wrong = read_coarsely(pushes(0.5, noise=0.0))
    assert abs(wrong) > 0.25 * GRAIN
    model = mujoco.MjModel.from_xml_string(BLOCK)
    error = resting_error(model, None, cut_recordings(data, 0, 0, 160), np.zeros((2, 0)), capped=True)
    assert error[0] == 0
    assert error[1] == pytest.approx(wrong, abs=0.05 * GRAIN)  # nearer than the looks, which are a fifteenth apart
    cured = without_error(model, data, error)
    for before, after in zip(data, cured, strict=True):
        np.testing.assert_allclose(after.qpos, before.qpos - error, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(after.qvel, before.qvel)
    assert without_error(model, data, np.zeros(2)) is data


@pytest.mark.parametrize("seed", range(4))
def test_a_step_that_one_episode_shows_is_that_of_all(seed):
    """Whichever half the row with another reading is in; elsewhere a joint at rest is read with one number."""
    data, model = pushes(0.5, noise=0.0), mujoco.MjModel.from_xml_string(BLOCK)
    wrong = 0.25 * GRAIN
    height = float(np.median(data[0].qpos[:, 1])) + wrong
    still = [replace(e, qpos=np.column_stack([e.qpos[:, 0], np.full(len(e), height)])) for e in data]
    once = [
        *still[:3],
        replace(still[3], qpos=still[3].qpos + GRAIN * np.outer(np.arange(len(still[3])) == 70, [0, 1])),
    ]
    cut = cut_recordings(Dataset(once), 0, seed, 160)
    assert cut.encoders.grain(model)[1] == pytest.approx(GRAIN, rel=1e-6)
    error = resting_error(model, None, cut, np.zeros((2, 0)), capped=True)
    assert error[1] == pytest.approx(wrong, abs=0.05 * GRAIN)
    assert (cut_recordings(Dataset(still), 0, seed, 160).encoders.grain(model) == 0).all()


def test_an_encoder_at_rest_is_no_fault():
    """Without a fault none is named, though the same floor a quarter of a millimetre higher would explain a lot."""
    data, wrong = read_coarsely(pushes(0.5, noise=0.0))
    found = diagnose_gap(mujoco.MjModel.from_xml_string(BLOCK), data)
    assert found.verdict == "no_gap"
    assert found.encoder_error == {"up": pytest.approx(wrong, abs=0.05 * GRAIN)}
    reads = f"{abs(found.encoder_error['up']):.2g} m too {'high' if wrong > 0 else 'low'}"
    assert any(f"While it rests, up reads {reads}" in line for line in found.summary)


TWO = """
<mujoco><option timestep="0.002" integrator="Euler"/><worldbody>
  <body><joint name="swings" axis="0 1 0" stiffness="{stiffness}"/>
    <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.5" mass="1"/></body>
  <body pos="1 0 0"><joint name="rests" axis="0 0 1" damping="1"/>
    <geom type="capsule" size=".03" fromto="0 0 0 .5 0 0" mass="1"/></body></worldbody>
<actuator><motor joint="swings"/></actuator></mujoco>
"""


def test_a_model_that_diverges_has_no_say_in_what_encoders_err_by():
    """The text is about the simulation, though a joint rests between two steps of its encoder."""
    rng, episodes = np.random.default_rng(0), []
    for number in range(4):
        model = mujoco.MjModel.from_xml_string(TWO.format(stiffness=0))
        data, rows = mujoco.MjData(model), 200
        data.qpos[0] = rng.normal()
        ctrl = 2 * np.sin(0.1 * np.arange(rows) + number)[:, None]
        qpos, qvel = np.empty((2, rows, 2))
        for row in range(rows):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            mujoco.mj_step(model, data, 10)
        qpos[:, 1] = 1e-3 * (rng.random(rows) < 0.1)
        qpos[:, 0] = 1e-3 * np.round(qpos[:, 0] / 1e-3)
        episodes.append(Episode(str(number), 0.02 * np.arange(rows), qpos, qvel, ctrl))
    sound, wild = (mujoco.MjModel.from_xml_string(TWO.format(stiffness=k)) for k in (0, 3e7))
    cut = cut_recordings(Dataset(episodes), 0, 0, 160)
    assert cut.encoders.resting(sound).tolist() == [False, True]
    with pytest.raises(SimulationDiverged):
        diagnose_gap(wild, Dataset(episodes), windows=20)


@pytest.mark.parametrize("target", ["up", 1, "#1"])
def test_a_free_offset_does_not_get_in_the_way(target):
    """However its joint is named."""
    space = ParameterSpace([Parameter("joint_offset.offset", target, low=-0.1, high=0.1)])
    replay = Replay(mujoco.MjModel.from_xml_string(BLOCK), space, [ReadingOffset(1, offset=(-GRAIN, GRAIN))])
    windows = pushes(0.5, rows=60, noise=0.0).windows(2)
    # a joint reads what both offsets make of its height, so that one takes the other back
    both, none = replay.predict(np.array([[1e-4, -1e-4], [0.0, 0.0]]), windows)
    np.testing.assert_allclose(both, none, rtol=0, atol=1e-12)
