"""How large a gap is, against what its definition and probability say."""

import numpy as np
import pytest

from nfpde.gap.levels import Yardstick, calm, rare, shrink_interval


def test_shrink_interval():
    """A gap that halves in every window shrinks by one half, surely."""
    before = np.random.default_rng(6).uniform(1, 2, 50)
    assert shrink_interval(before, before / 2, np.arange(50) // 5, 0) == pytest.approx((0.5, 0.5, 0.5))


def test_yardstick_counts_in_units_of_noise():
    """Residuals that are noise and nothing else have the gap of the noise."""
    rng = np.random.default_rng(7)
    noise, other = rng.normal(size=(2, 2000, 2, 4))
    stick = Yardstick.of(noise[None], noise)
    assert stick.gap(other).mean() == pytest.approx(stick.floor.mean(), rel=0.05)


def test_what_acts_in_few_windows_is_capped_only_beside_contacts():
    """Two windows of a hundred with a thousandfold residual hold the gap of smooth motion, and none beside contacts."""
    rng = np.random.default_rng(11)
    noise = rng.normal(size=(3, 100, 2, 4))
    few = noise[0].copy()
    few[[20, 70]] *= 1000
    smooth, rugged = Yardstick(np.ones((2, 4)), noise, 0.0), Yardstick(np.ones((2, 4)), noise)
    assert smooth.gap(few).mean() == pytest.approx((few**2).mean())
    assert rugged.gap(few).mean() < 1.5 * rugged.floor.mean()
    lost = few.copy()
    lost[3] = np.nan
    assert calm(lost**2, 0.0)[3] == pytest.approx(np.nanmax(lost**2, axis=0))  # bad, but not beyond bounds


def test_rare_windows_are_noise_as_often_as_they_say():
    """With the heaviest tails that have no mean, p <= 0.05 comes in five of a hundred at most; far windows are sure."""
    rng = np.random.default_rng(13)
    block = np.arange(100)
    alarms = [rare(1 / rng.random(100), 1 / rng.random(100), block) <= 0.05 for _ in range(2000)]
    assert np.mean(alarms) < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 2000)
    gap, noise = rng.random(100), rng.random(100)
    gap[[5, 25, 45, 65]] = 20.0
    assert rare(gap, noise, block // 5) < 1e-4
    gap[[5, 25, 45, 65]] = 0.5
    gap[5:9] = 20.0  # neighbours count once
    assert rare(gap, noise, block // 5) > 0.005
