"""Effects that shrink a gap near the noise beside contacts by less than is worth a name: what noise gives decides."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.acceptance import NOISE_TIMES, WORTH
from nfpde.gap.levels import Yardstick
from nfpde.gap.select import Selection
from nfpde.gap.trial import Court, Trial

ANYTHING: Any = None

BIAS = effect("actuator_bias", "bend", offset=(-1.0, 1.0))

BLOCK = np.arange(60) // 3

GAIN = 0.5
"""Held-out log density that the candidate gains in every window [nats]; certain, as twenty blocks agree."""

LITTLE = 1.0 - 0.3 * WORTH
"""Share of the gap that the candidate leaves."""


class Known:
    """Longest windows whose gaps are known."""

    def __init__(self, before: float, after: float):
        self.found = before, after

    def gaps(self, current, trial, sigma):
        return self.found


class Judging(Selection):
    """A selection that knows what noise gives the candidate per window."""

    noise = 0.0

    def floor(self, trial):
        return 1.0

    def given_by_noise(self, trial, current, sigma, gain):
        return self.noise >= gain


def trial(effect_: Any, gaps: np.ndarray, density: float) -> Trial:
    """A trial that leaves a gap in every window of both halves (60,)."""
    residuals = np.sqrt(gaps)[:, None, None] * np.ones((60, 2, 4))
    replay = SimpleNamespace(sim=SimpleNamespace(simulated_steps=0), effects=() if effect_ is None else (effect_,))
    fit: Any = SimpleNamespace(residuals=residuals, replay=replay, cost=0.0)
    told = density + 1e-3 * np.sin(np.arange(60))
    return Trial(effect_, fit, told, residuals, told)


def selection(far: tuple[float, float] | None, *, touches: bool = True) -> Judging:
    """Over short windows; every channel's noise is one."""
    court = Court(BLOCK, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)
    yardstick = Yardstick(np.ones((2, 4)), np.ones((1, 60, 2, 4)), 0.0)
    there: Any = None if far is None else Known(*far)
    sigma = np.ones(4) if touches else None
    return Judging(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=sigma, far=there, last=far is None)


@pytest.mark.parametrize(
    ("gap", "left", "noise", "far", "touches", "named"),
    [
        (1.1, LITTLE, 0.0, None, True, True),
        (1.1, LITTLE, 0.0, (1.1, 1.1), True, True),
        (1.1, LITTLE, 0.0, (1.1, 1.1 * (1 + 0.9 * WORTH)), True, True),  # as much as before, by what counts there
        (1.1, LITTLE, 0.0, (1.1, 1.1 * (1 + 1.1 * WORTH)), True, False),  # it makes long windows worse
        (1.1, LITTLE, 0.9 * GAIN / NOISE_TIMES, None, True, True),
        (1.1, LITTLE, 1.1 * GAIN / NOISE_TIMES, None, True, False),  # noise gives as much
        (1.1, 1.0, 0.0, None, True, False),  # it leaves the gap as it is
        (11.0, LITTLE, 0.0, None, True, False),  # far from the noise so little is of no use
        (1.1, LITTLE, 0.0, None, False, False),  # nor in smooth motion, where what is sure need not be noise
    ],
)
def test_near_the_noise_what_noise_gives_decides_about_small_effects(gap, left, noise, far, touches, named):
    chosen = selection(far, touches=touches)
    chosen.noise = noise
    gaps = gap * np.ones(60)
    current, candidate = trial(None, gaps, 0.0), trial(BIAS, left * gaps, GAIN)
    found = chosen.accept(current, [candidate], gap)
    assert (found is not None) is named
    if found is not None:
        assert found[0] is candidate


@pytest.mark.parametrize("worse", ["most windows", "the mean"])
def test_a_gap_is_less_in_the_mean_and_in_most_windows(worse):
    """A few windows that outweigh the others, and many that lose next to nothing, are no proof of anything."""
    chosen = selection(None)
    before = np.ones(60)
    before[0] = 10.0
    after = before.copy()
    if worse == "most windows":
        after *= 1.05
        after[0] = 1.0
        assert after.mean() < before.mean()
    else:
        after *= 0.97
        after[0] = 20.0
        assert np.exp(np.log(after).mean()) < np.exp(np.log(before).mean())
    assert not chosen.lessens(trial(BIAS, after, 0.0), trial(None, before, 0.0))
    assert chosen.lessens(trial(BIAS, 0.99 * before, 0.0), trial(None, before, 0.0))


def test_a_small_effect_is_named_alone_and_not_beside_another():
    """Beside another it may make up for what that one got wrong."""
    gaps = 1.1 * np.ones(60)
    current, candidate = trial(None, gaps, 0.0), trial(BIAS, LITTLE * gaps, GAIN)
    beside: Any = replace(current)
    beside.fit.replay.effects = (BIAS,)
    assert selection(None).accept(beside, [candidate], 1.1) is None
    beside.fit.replay.effects = ()
    assert selection(None).accept(beside, [candidate], 1.1) is not None
