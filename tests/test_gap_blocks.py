"""Groups of neighbouring windows, whose gains are averaged before standard errors are taken."""

from collections import Counter

import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.gap.brief import EVERY, MOST, brief
from nfpde.gap.recordings import BLOCK, LEAST_BLOCKS, WINDOW_TIME, blocks_of, cut_recordings
from tests.test_gap_contacts import pushes


@pytest.mark.parametrize("most", [MOST, EVERY])
def test_blocks_of_short_windows_last_as_long_as_a_long_one(most):
    """Single steps that follow each other are as alike as they were within one window."""
    recordings = cut_recordings(pushes(0.5, rows=2000), 0, 0, 160)
    for short in brief(recordings, most):
        episodes = short.held.episode
        for number in np.unique(short.block):
            mine = np.flatnonzero(short.block == number)
            assert len(mine) >= BLOCK
            assert np.unique(episodes[mine]).size == 1
            lasts = (np.ptp(short.held.row[mine]) + short.held.horizon) * short.held.control_dt
            assert lasts > 0.8 * WINDOW_TIME  # ends fall between windows


def test_short_recordings_have_blocks_all_the_same():
    """So many that errors are known, with windows for them."""
    short = brief(cut_recordings(pushes(0.5, rows=150), 0, 0, 160), EVERY)[0]
    assert len(np.unique(short.block)) + len(np.unique(short.held.episode)) >= LEAST_BLOCKS
    assert min(Counter(short.block.tolist()).values()) >= BLOCK


def test_standard_errors_of_what_goes_on_for_a_while_are_right():
    """The mean of an autoregression of 20 ms over single steps: blocks tell its variance to a quarter."""
    rng, rows, keep = np.random.default_rng(0), 4000, np.exp(-1 / 2)
    time = 0.01 * np.arange(rows)
    rest = np.zeros((rows, 1))
    still = [Episode(str(i), time, rest, rest, rest) for i in range(2)]
    windows = Dataset(still).windows(1)
    block = blocks_of(windows)
    count = block.max() + 1
    means, believed = [], []
    for _ in range(400):
        x = np.zeros(len(windows))
        shock = rng.normal(size=len(x))
        for i in range(1, len(x)):
            x[i] = keep * x[i - 1] + shock[i]
        of = np.bincount(block, x) / np.bincount(block)
        means.append(x.mean())
        believed.append(of.var(ddof=1) / count)
    assert np.mean(believed) == pytest.approx(np.var(means), rel=0.25)
