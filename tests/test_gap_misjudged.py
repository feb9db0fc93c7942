"""Noise that was believed too large before anything was found, in smooth motion: what it hid is asked about."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.levels import Yardstick
from nfpde.gap.search import Search
from nfpde.gap.select import Selection
from nfpde.gap.stage import Stage
from nfpde.gap.trial import Court, Trial

ANYTHING: Any = None

SHAPE = (60, 2, 4)


class Counted:
    """A simulator that has simulated a few steps."""

    simulated_steps = 7


COURT = Court(np.arange(60) // 3, ANYTHING, ANYTHING, np.zeros(SHAPE[1:]), np.zeros(0), ANYTHING)


class SameWindows(Stage):
    """A stage on which a trial leaves what it left on any other."""

    def shown(self, trial, *, refitted):
        return trial


def stage(noise: float, sigma: float = 1.0) -> Stage:
    """One that takes `noise` for the standard deviation of what sensors put on predictions."""
    draws = noise * np.random.default_rng(1).normal(size=(12, *SHAPE))
    scale = Yardstick(np.ones(SHAPE[1:]), draws, 0.0)
    return SameWindows(ANYTHING, ANYTHING, ANYTHING, COURT, scale, np.full(4, sigma))


def hid(left: float, before: float, after: float) -> bool:
    """Whether noise that was believed `before`, and is known to be `after`, may have hidden what is `left`."""
    trial = Trial(None, ANYTHING, np.zeros(60), left * np.random.default_rng(2).normal(size=SHAPE), np.zeros(60))
    search = Search(ANYTHING, ANYTHING, [], np.zeros((1, 0)), 80, 0, ANYTHING, ANYTHING)
    near = stage(before)
    selection = Selection(ANYTHING, None, 1, COURT, [], yardstick=near.yardstick).over(near)
    return search._may_hide(near, selection, trial) and search._hid(stage(after), selection, trial)


@pytest.mark.parametrize(
    ("left", "before", "after", "expected"),
    [
        (1.4, 1.5, 1.0, True),  # below the old floor, twice the new one
        (1.4, 1.5, 1.5, False),  # the noise stands
        (1.0, 1.5, 1.0, False),  # less noise, and nothing beyond it
        (1.4, 1.0, 1.0, False),  # it stood out before, and was asked about then
    ],
)
def test_a_gap_that_falls_out_of_the_noise_is_asked_about(left, before, after, expected):
    """Squares of 480 channels scatter by 6 %, far less than the factors between them."""
    assert hid(left, before, after) is expected


@pytest.mark.parametrize(("after", "expected"), [(0.9, False), (0.4, True)])
def test_beside_contacts_the_sensors_noise_itself_must_have_halved(after, expected, monkeypatch):
    """There floors are known to a factor only. The noise is asked before anything else is made of the windows."""
    monkeypatch.setattr(
        "nfpde.gap.search.sensor_noise", lambda replay, xi, rows, encoders: np.array([2.0 * after, 2.0])
    )
    near: Any = SimpleNamespace(
        misjudged=2.0, sigma=np.ones(2), recordings=SimpleNamespace(rows=ANYTHING, encoders=ANYTHING)
    )
    final: Any = SimpleNamespace(fit=SimpleNamespace(replay=SimpleNamespace(sim=Counted()), xi=ANYTHING))
    soft = effect("contact_softness", time_constant=(0.001, 0.1), damping_ratio=(0.1, 2.0))
    search = Search(ANYTHING, ANYTHING, [(soft, np.ones((1, 2)))], np.zeros((1, 0)), 80, 0, ANYTHING, ANYTHING)
    selection = Selection(ANYTHING, None, 1, COURT, [], yardstick=ANYTHING)
    assert search._may_hide(near, selection, final) is expected
    assert selection.steps == 7
    assert search._hid(ANYTHING, selection, final)
