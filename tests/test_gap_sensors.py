"""The noise of the sensors: its size, the grain of encoders, and what it makes of predictions."""

from dataclasses import replace

import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.gap.grain import Encoders
from nfpde.gap.loud import noise_residuals
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.sensors import _likeliest, sensor_noise
from tests.gap_systems import nominal, record


def test_sensor_noise_is_found():
    """Noise put on positions and velocities comes back, to the precision of a median over the rows."""
    data = record(noise=1e-3)
    replay = Replay(nominal(), None, [])
    rows = data.windows(1)
    sigma = sensor_noise(replay, np.zeros(0), rows, Encoders.of([rows.start]))
    assert sigma == pytest.approx(1e-3 * np.array([0.5, 0.8, 3.0, 8.0]), rel=0.1)


@pytest.mark.parametrize("rows", [60, 300])
def test_the_grain_of_an_encoder_is_found(rows):
    """Steps of each joint's encoder, of a robot that moves and of one that hardly does; none where there is none."""
    grain, rng = np.array([1.5e-3, 4e-4]), np.random.default_rng(12)
    model = nominal()
    for size in (0.5, 4e-3):
        read = size * rng.normal(size=(rows, 2)).cumsum(axis=0) / np.sqrt(rows)
        steps = grain * np.round(read / grain) + 1e-17 * rng.normal(size=read.shape)  # rounding
        speed = rng.normal(size=(rows, 2))
        for qpos, wanted in ((steps, grain), (read, np.zeros(2))):
            data = Dataset([Episode("0", 0.01 * np.arange(rows), qpos, speed, np.zeros((rows, model.nu)))])
            found = Encoders.of([data.windows(1).start]).grain(model)
            assert found == pytest.approx([*wanted, 0.0, 0.0], rel=1e-6)


def test_a_reading_that_never_changes_has_no_grain():
    """A robot that lies still is read with one number."""
    still = np.full((50, 2), 0.3)
    data = Dataset([Episode("0", 0.01 * np.arange(50), still, np.zeros((50, 2)), np.zeros((50, nominal().nu)))])
    assert (Encoders.of([data.windows(1).start]).grain(nominal()) == 0).all()


def test_an_episode_elsewhere_tells_nothing_of_the_grain():
    """A joint that is held at another place in one episode; a reading that is off; an encoder that was zeroed anew."""
    still = np.full((200, 1), 0.328)
    assert Encoders.of([still, still, still, still + 0.394]).steps.tolist() == [0.0]
    steps = np.round(np.random.default_rng(0).normal(size=(4, 200, 1)).cumsum(axis=1)) * 1e-3
    off = steps[1].copy()
    off[77] += 3e-4
    found = Encoders.of([steps[0], off, steps[2] + 3.7e-4, steps[3]])
    assert found.steps == pytest.approx([1e-3], rel=1e-6)
    assert np.isnan(found.rest).all()


def test_short_episodes_tell_the_grain_together():
    """None shows readings enough by itself."""
    steps = np.round(2 * np.random.default_rng(0).normal(size=(40, 8, 1))) * 1e-3
    assert all(Encoders.of([e]).steps[0] == 0 for e in steps)
    assert Encoders.of(list(steps)).steps == pytest.approx([1e-3], rel=1e-6)


def test_noise_at_rest_is_that_of_the_grain():
    """What an encoder is off by at rest is the same in every row; it counts as noise all the same."""
    data = record()
    coarse = [replace(e, qpos=2e-2 * np.round(e.qpos / 2e-2)) for e in data]
    replay = Replay(nominal(), None, [])
    rows = Dataset(coarse).windows(1)
    sigma = sensor_noise(replay, np.zeros(0), rows, Encoders.of([rows.start]))
    assert (sigma[:2] >= 2e-2 / np.sqrt(12) * (1 - 1e-6)).all()
    assert (sigma[:2] < 2 * 2e-2 / np.sqrt(12)).all()


def test_noise_residuals_match_what_noise_does():
    """The spread predicted from the noise is the spread that a perfect model shows on noisy recordings."""
    data = record(noise=1e-3)
    replay = Replay(nominal(), None, [])
    cut = cut_recordings(data, 0, 0, 160)
    sigma = 1e-3 * np.array([0.5, 0.8, 3.0, 8.0])
    predicted = noise_residuals(replay, np.zeros(0), cut.held, cut.horizons, sigma, 0)[0]
    actual = replay.residuals(np.zeros((1, 0)), cut.held, cut.horizons)[0]
    ratio = (actual**2).mean(0) / (predicted**2).mean(0)
    assert ratio == pytest.approx(1.0, abs=6 * np.sqrt(2 / len(cut.held)) * np.sqrt(2))  # two sample variances


def test_a_bend_beyond_double_precision_hides_no_noise():
    """Clean recordings with contacts: in half of the rows what bends is 1e9 times the noise, in one direction."""
    rng = np.random.default_rng(0)
    n, true = 400, 1e-13 * np.array([1.0, 2.0, 0.5, 4.0])
    slopes = np.array([-0.5, 1.5, -1.5, 0.5])[:, None, None, None] * np.eye(4) * np.ones((n, 1, 1))
    high = np.einsum("knij,knj->ni", slopes, true * rng.normal(size=(4, n, 4)))
    way = rng.normal(size=(n, 4)) * (np.arange(n) % 2)[:, None] * 1e9 * true
    high += way * rng.normal(size=(n, 1))
    found = _likeliest(high, slopes, np.einsum("ni,nj->nij", way, way), 3 * true)
    # a standard deviation of 200 rows, each with three directions and more that do not bend, to four standard errors
    np.testing.assert_allclose(found / true, 1.0, atol=4 / np.sqrt(2 * 200))
