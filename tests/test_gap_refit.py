"""Candidates refitted on a part of the windows, and counted on all of them."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.fit import Fitter
from nfpde.gap.noise import learn_scatter
from nfpde.gap.refit import STEPS, Refitting, towards
from nfpde.gap.screen import Screened
from nfpde.gap.trial import Court
from tests.gap_straight import Change

ANYTHING: Any = None


def fit_of(which, xi) -> Any:
    return SimpleNamespace(replay=SimpleNamespace(effects=[which]), xi=np.array(xi))


def test_the_way_from_no_effect():
    """Parameters and sizes in proportion; where a mass sits is no matter of more or less, and stays."""
    load = effect("payload", "hand", mass=(0, 2), position_x=(-1, 1), position_y=(-1, 1), position_z=(-1, 1))
    places = towards(np.array([2.0]), fit_of(load, [4.0, 1.0, 0.5, 0.0, -0.5]))
    assert places == pytest.approx(np.array([[2 + 2 * s, s, 0.5, 0.0, -0.5] for s in (1.0, *STEPS)]))


def test_there_is_no_way_from_no_limit():
    """A torque limit that does nothing is infinite."""
    limit = effect("torque_limit", "elbow", limit=(1, 9))
    assert towards(np.zeros(0), fit_of(limit, [3.0])) == pytest.approx(np.array([[3.0]]))


@pytest.mark.parametrize("size", [0.09, 0.27, 0.9])
def test_a_part_of_the_windows_leads_too_far(size):
    """It said .9; of that, a third, and a tenth, what all windows like best is kept: slopes begin there."""
    rng = np.random.default_rng(41)
    slope = rng.normal(size=(60, 1, 2))
    noise = 0.01 * rng.normal(size=slope.shape)
    rub = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    replay: Any = Change(noise - size * slope, slope, [rub])
    floor, fitter = 1e-6 * np.ones((1, 2)), Fitter(ANYTHING, (1, 2))
    scatter = learn_scatter(noise, 0, floor)
    court = Court(np.arange(60) // 5, fitter, fitter, floor, np.zeros(0), ANYTHING)
    base: Any = SimpleNamespace(xi=np.zeros(0), scatter=scatter, residuals=replay.start, slopes=np.zeros((0, 60, 1, 2)))
    far = fitter.start(replay, np.array([[0.9]]), scatter)
    refitting = Refitting.__new__(Refitting)
    refitting._court, refitting._base = court, base
    found = refitting._whole(Screened(rub, replay, np.array([[0.9]]), (1.0,), 1.0, ()), far)
    assert found.xi == pytest.approx([size])
