"""Whether noise by itself leaves as much as a model does: tests against draws of a known distribution."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.gap.chance import ROUNDS, by_chance
from nfpde.gap.fit import Fitter
from nfpde.gap.levels import FLOOR_ERROR, least_ratio, shrink_interval
from nfpde.gap.trial import DRAWS

ANYTHING: Any = None
HELD = Fitter(ANYTHING, (1,), force=np.ones(2))
BLOCK = np.arange(60) // 3


@pytest.fixture
def draws(monkeypatch):
    """Draws of noise with heavy tails, (DRAWS, 60, 4, 2) a time, of which those that were asked for are remembered."""
    asked: list[int] = []

    def noise_of(fit: Any, sigma: Any, half: Fitter, seed: int) -> Any:
        assert half.force is None  # a model that is pushed aside is another
        asked.append(seed)
        return np.random.default_rng([fit.number, seed]).standard_t(5, size=(DRAWS, 60, 4, 2))

    monkeypatch.setattr("nfpde.gap.chance.noise_of", noise_of)
    return asked


def size(residuals: Any) -> float:
    return float(np.mean(np.square(residuals)))


def test_all_draws_are_looked_at_where_none_leaves_as_much(draws):
    fit: Any = SimpleNamespace(number=0)
    every = [np.random.default_rng([0, 1000 + n]).standard_t(5, size=(DRAWS, 60, 4, 2)) for n in range(ROUNDS)]
    largest = max(size(draw) for draw in np.concatenate(every))
    # the floor that draws are compared by is known to a tenth
    assert not by_chance(fit, ANYTHING, HELD, size, largest * (1 + FLOOR_ERROR) * 1.0001)
    assert len(draws) == len(set(draws)) == ROUNDS
    assert by_chance(fit, ANYTHING, HELD, size, largest * (1 + FLOOR_ERROR) * 0.9999)


def test_no_more_is_drawn_after_one_that_does(draws):
    fit: Any = SimpleNamespace(number=0)
    assert by_chance(fit, ANYTHING, HELD, size, 0.0)
    assert len(draws) == 1


def test_noise_is_seldom_beyond_chance(draws):
    """One in 205 at most, where a tenth more makes no difference; eight of 400 have a probability of 0.1 %."""
    loud = 0
    for number in range(400):
        fit: Any = SimpleNamespace(number=number)
        own = np.random.default_rng([5, number]).standard_t(5, size=(60, 4, 2))
        loud += not by_chance(fit, ANYTHING, HELD, size, size(own))
    assert loud < 8


def test_what_is_beyond_chance_is_seen(draws):
    """Five times the noise: its square is beyond the tails of sums of 480 squares."""
    fit: Any = SimpleNamespace(number=1)
    own = np.random.default_rng(3).standard_t(5, size=(60, 4, 2))
    assert not by_chance(fit, ANYTHING, HELD, size, size(5 * own))


def test_ratios_of_means_are_those_of_one_column_after_the_other():
    """The lower end of a ratio is what the upper end of the share that is removed leaves."""
    rng = np.random.default_rng(0)
    floor, gap = rng.chisquare(2, size=(60, 5)), 1.5 * rng.chisquare(1, size=(60, 5))
    each = [1.0 - shrink_interval(floor[:, k], gap[:, k], BLOCK, 4)[2] for k in range(5)]
    assert least_ratio(gap, floor, BLOCK, 4) == pytest.approx(each, rel=1e-12)
    assert least_ratio(2.5 * floor, floor, BLOCK, 4) == pytest.approx(2.5, rel=1e-12)


def test_lower_ends_lie_below_the_truth():
    """Of 2000 ratios that are one, some 2.5 % have a lower end above it; resampled blocks are few, and allow double."""
    rng = np.random.default_rng(1)
    gap, floor = rng.chisquare(8, size=(2, 60, 2000))
    assert 0.01 < (least_ratio(gap, floor, BLOCK, 0) > 1.0).mean() < 0.05
