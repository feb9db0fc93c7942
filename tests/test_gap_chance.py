"""Whether noise by itself leaves as much as a model does: tests against draws of a known distribution."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student

from nfpde.gap.bootstrap import STILL
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


class Told:
    """What every draw leaves is given, one after the other."""

    def __init__(self, *values: float) -> None:
        self.values = iter(values)

    def __call__(self, residuals: Any) -> float:
        return next(self.values)


@pytest.mark.parametrize(("last", "chance"), [(1.0, False), (4.0, True)])
def test_all_draws_are_looked_at_where_they_scatter_as_far(last, chance, draws):
    """Logarithms of plus and minus one, and four at the end: who leaves exp(2) is two deviations from the mean."""
    logs = np.tile([-1.0, 1.0], ROUNDS * DRAWS // 2)
    logs[-1] = last
    fit: Any = SimpleNamespace(number=0)
    # the floor that draws are compared by is known to a tenth
    assert by_chance(fit, ANYTHING, HELD, Told(*np.exp(logs)), (1 + FLOOR_ERROR) * float(np.exp(2.0))) is chance
    assert len(draws) == len(set(draws)) == ROUNDS


@pytest.mark.parametrize(("share", "rounds"), [(1.01, 1), (0.99, 2)])
def test_no_more_is_drawn_where_the_first_ones_tell(share, rounds, draws):
    """Of a dozen draws, half of them at plus one, half at minus one, those to come are told by Student's quantile."""
    deviation = (12 / 11) ** 0.5
    bound = float(student.isf(STILL / ((ROUNDS - 1) * DRAWS), DRAWS - 1)) * (1 + 1 / 12) ** 0.5 * deviation
    fit: Any = SimpleNamespace(number=0)
    told = Told(*np.exp(np.tile([-1.0, 1.0], ROUNDS * DRAWS // 2)))
    assert not by_chance(fit, ANYTHING, HELD, told, (1 + FLOOR_ERROR) * float(np.exp(share * bound)))
    assert len(draws) == rounds


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
