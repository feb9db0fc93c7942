"""What an effect is worth over the longest windows, where short ones hardly show it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.acceptance import WORTH
from nfpde.gap.brief import brief
from nfpde.gap.far import Far
from nfpde.gap.fit import Fitter
from nfpde.gap.levels import FLOOR_ERROR, Yardstick
from nfpde.gap.noise import learn_scatter
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.select import Selection
from nfpde.gap.trial import Court, Trial
from tests.gap_systems import nominal, record

ANYTHING: Any = None

BIAS = effect("actuator_bias", "bend", offset=(-1.0, 1.0))

NOISE = 1e-3


class Known:
    """Longest windows whose gaps are known."""

    def __init__(self, before: float, after: float):
        self.found = before, after

    def gaps(self, current, trial, sigma):
        return self.found


def gap(left: float) -> Trial:
    """A trial that leaves as much in both halves."""
    residuals = np.sqrt(left) * np.ones((40, 2, 4))
    fit: Any = SimpleNamespace(residuals=residuals, replay=SimpleNamespace(sim=SimpleNamespace(simulated_steps=3)))
    return Trial(None, fit, np.zeros(40), residuals, np.zeros(40))


@pytest.mark.parametrize(
    ("left", "far", "touches", "worth", "looks"),
    [
        (0.999, (1.0, 1.0 - 1.1 * WORTH), True, True, True),
        (0.999, (1.0, 1.0 - 0.9 * WORTH), True, False, True),
        (1.001, (1.0, 0.5), True, False, False),  # it makes these windows worse
        (0.999, (1.0, 0.5), False, False, False),  # in smooth motion all windows are the longest
        (1.0 - 1.1 * FLOOR_ERROR, (1.0, 2.0), True, True, False),  # these are enough
    ],
)
def test_what_short_windows_hardly_show_is_worth_what_it_is_over_long_ones(left, far, touches, worth, looks):
    """If it shrinks the gap here at all."""
    court = Court(np.arange(40) // 4, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)
    yardstick = Yardstick(np.ones((2, 4)), np.ones((1, 40, 2, 4)), 0.0)
    there: Any = Known(*far)
    sigma = np.zeros(4) if touches else None
    selection: Any = Selection(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=sigma, far=there, last=False)
    assert selection.shrinks(gap(left), gap(1.0), 1.0) is worth
    assert selection.steps == (6 if looks else 0)  # of both models, where the longest windows were asked


def test_a_small_torque_shows_in_long_windows_and_not_in_single_steps():
    """In 10 ms it moves 0.04 kgm2 by a tenth of the error of the speeds or less, in 250 ms by more."""
    data = record(force=lambda data: 0.003, noise=NOISE, rows=1200)
    cut = cut_recordings(data, 0, 0, 160)
    sigma = NOISE * np.array([0.5, 0.8, 3.0, 8.0])

    def trial(replay: Replay, xi: list[float], fitter: Fitter) -> Trial:
        left = fitter.residuals_at(replay, np.array([xi]))[0]
        fit = fitter.start(replay, np.array([xi]), learn_scatter(left, 0, 1e-9 * np.ones(left.shape[1:])))
        return Trial(None, fit, np.zeros(len(left)), left, np.zeros(len(left)))

    def shrinks(recordings) -> float:
        fitter = Fitter(recordings.fit, recordings.horizons)
        without, pushed = (trial(Replay(nominal(), None, e), x, fitter) for e, x in (([], []), ([BIAS], [0.003])))
        before, after = Far(recordings, 0.0).gaps(without, pushed, sigma)
        assert after == pytest.approx(1.0, rel=0.1)  # 1300 squares of noise or more
        return 1.0 - after / before

    assert shrinks(brief(cut)[0]) < WORTH
    assert shrinks(cut) > 10 * WORTH
