"""Halves of the recordings that contradict each other."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.levels import Yardstick
from nfpde.gap.trial import LEAST_GAIN, Court, Trial
from tests.gap_straight import ByGain

ANYTHING: Any = None

RUB = effect("coulomb_friction", "bend", torque=(0.0, 1.0))
STICK = effect("stribeck_friction", "bend", coulomb=(0.0, 1.0), static=(0.0, 1.0), speed=(0.01, 1.0))

COURT = Court(np.arange(40) // 4, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)


def trial(which, left: float, held: float, fitted: float) -> Trial:
    """A trial that leaves a gap; log densities of both halves, the held-out one scattered a little over its windows."""
    density = held / 40 + 0.01 * np.sin(np.arange(40) + (which is RUB))
    residuals = np.sqrt(left) * np.ones((40, 2, 4))
    fit: Any = SimpleNamespace(cost=-fitted, residuals=residuals)
    return Trial(which, fit, density, residuals, density)


@pytest.mark.parametrize(
    ("held", "fitted", "left", "declared"),
    [
        (-60.0, 160.0, 2.0, True),  # the half it was fitted to says more for it than the other against it
        (-60.0, 60.0 + LEAST_GAIN - 1.0, 2.0, False),  # no more than chance
        (-60.0, 0.0, 2.0, False),  # both halves are against it, or one, and the other for none
        (-60.0, 160.0, 30.0, False),  # it leaves much that the other explains
    ],
)
def test_halves_that_contradict_each_other_tell_nothing_apart(held, fitted, left, declared):
    """The friction that foretells better is named; the other is declared where both halves together favour it."""
    yardstick = Yardstick(np.ones((2, 4)), np.ones((1, 40, 2, 4)), 0.0)
    selection = ByGain(ANYTHING, None, 1, COURT, [], yardstick=yardstick)
    base, rub, stick = (
        trial(None, 100.0, -900.0, -900.0),
        trial(RUB, 2.0, 0.0, 0.0),
        trial(STICK, left, held, fitted),
    )
    found = selection.accept(base, [rub, stick], selection.gap_of(base))
    assert found is not None
    assert found[0] is rub
    assert [t.effect for t in found[1].rivals] == ([STICK] if declared else [])


@pytest.mark.parametrize(
    ("held", "fitted", "left", "named"),
    [
        (-60.0, 160.0, 1.0, STICK),  # both halves together favour it, and it leaves far less
        (-60.0, 160.0, 29.0, RUB),  # it leaves nearly as much
        (-60.0, 0.0, 1.0, RUB),  # both halves together are against it
    ],
)
def test_who_is_clearer_in_both_halves_together_is_named(held, fitted, left, named):
    """Where nothing slides any friction is enough, and this half foretells worse by the one that the other tells."""
    yardstick = Yardstick(np.ones((2, 4)), np.ones((1, 40, 2, 4)), 0.0)
    selection = ByGain(ANYTHING, None, 1, COURT, [], yardstick=yardstick)
    base, rub, stick = trial(None, 100.0, -900.0, -900.0), trial(RUB, 30.0, 0.0, 0.0), trial(STICK, left, held, fitted)
    found = selection.accept(base, [rub, stick], selection.gap_of(base))
    assert found is not None
    assert found[1].effect is named
    if named is STICK:
        assert [t.effect for t in found[1].rivals] == [RUB]
