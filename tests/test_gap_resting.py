"""Encoders of joints that rest: what they err by is found, and is no fault of the robot."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset
from nfpde.gap import diagnose_gap
from nfpde.gap.grain import resting
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.resting import resting_error, without_error
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


def test_joints_that_rest_are_told_from_those_that_move():
    """One reading in most rows, however the rest is spread; never a joint that is read anew in every row."""
    data, _ = read_coarsely(pushes(0.5, noise=0.0))
    model = mujoco.MjModel.from_xml_string(BLOCK)
    assert resting(model, data.windows(1)).tolist() == [False, True]
    for share, rests in ((0.4, True), (0.6, False)):
        moved = [replace(e, qpos=e.qpos + GRAIN * _some(e.qpos, share)) for e in data]
        assert resting(model, Dataset(moved).windows(1)).tolist() == [False, rests]


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


def test_an_encoder_at_rest_is_no_fault():
    """Without a fault none is named, though the same floor a quarter of a millimetre higher would explain a lot."""
    data, wrong = read_coarsely(pushes(0.5, noise=0.0))
    found = diagnose_gap(mujoco.MjModel.from_xml_string(BLOCK), data)
    assert found.verdict == "no_gap"
    assert found.encoder_error == {"up": pytest.approx(wrong, abs=0.05 * GRAIN)}
    reads = f"{abs(found.encoder_error['up']):.2g} m too {'high' if wrong > 0 else 'low'}"
    assert any(f"While it rests, up reads {reads}" in line for line in found.summary)
