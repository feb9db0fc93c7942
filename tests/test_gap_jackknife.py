"""What fitted parameters scatter by, where the scatter of the residuals is learned from the same few windows."""

from typing import Any

import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.estimation.trajectory.student import GAUSSIAN, Student
from nfpde.gap.fit import Fitter
from nfpde.gap.jackknife import moves_without
from nfpde.gap.noise import Scatter, learn_scatter
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.trial import Court
from tests.gap_straight import Straight

WINDOWS, FIRST, CHANNELS = 70, 1, 10
ANYTHING: Any = None


def estimate(seed, draw):
    """Fit and scatter turn by turn, as a diagnosis does; the truth is .5 for all three parameters."""
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(CHANNELS, CHANNELS)) * np.logspace(0, -1, CHANNELS)
    matrix = rng.normal(size=(WINDOWS, CHANNELS, 3))
    replay = Straight(matrix, matrix @ np.full(3, 0.5) + draw(rng) @ mixing)
    court = Court(
        ANYTHING, Fitter(ANYTHING, (1, 2)), Fitter(ANYTHING, (1, 2)), np.full((1, CHANNELS), 1e-4), ANYTHING, ANYTHING
    )
    start = replay.residuals(np.full((1, 3), 0.4), ANYTHING, ())[0]
    fit = court.fitter.start(replay, np.full((1, 3), 0.4), learn_scatter(start, 0, court.floor))
    return court.fitter.linearise(court.settle(fit, rounds=4))


@pytest.mark.parametrize("degrees", [np.inf, 5.0])
def test_stated_errors_are_those_of_many_repetitions(degrees):
    """With windows that are their own yardstick; their weights are learned too, where tails are heavy.

    A sandwich with the same scatter states four fifths of the errors, or less.
    """

    def draw(rng):
        tails = np.sqrt(degrees / rng.chisquare(degrees, (WINDOWS, 1))) if np.isfinite(degrees) else 1.0
        return rng.normal(size=(WINDOWS, CHANNELS)) * tails

    ratios, by_sandwich = [], []
    for seed in range(150):
        fit = estimate(seed, draw)
        ratios.append((fit.xi - 0.5) / fit.standard_errors)
        by_sandwich.append((fit.xi - 0.5) / sandwich(fit))
    size, before = (float(np.sqrt(np.mean(np.square(x)))) for x in (ratios, by_sandwich))
    # three standard errors of a root mean square of 450 ratios to either side, and a jackknife's bias: it errs upwards
    assert 0.85 < size < 1.1
    assert before > 1.15


def sandwich(fit):
    """Standard errors (D,) from the outer product of the windows' scores, in the scatter that they themselves have."""
    white = fit.scatter.whiten(fit.residuals)
    slopes = fit.slopes[:, :, 0] @ fit.scatter.noises[0].whitener
    scores = np.einsum("dnc,nv,nvc->nd", slopes, fit.scatter.weights(white), white)
    inverse = np.linalg.inv(fit.information)
    turn = fit.replay.outward_slopes(fit.xi)
    return np.sqrt(np.diag(turn @ inverse @ scores.T @ scores @ inverse @ turn.T))


@pytest.mark.parametrize("windows", [80, 20])
def test_pulls_are_counted_in_the_scatter_of_all_others(windows):
    """By leaving a window out and learning anew; with few windows a scatter knows no correlations."""
    rng = np.random.default_rng(1)
    residuals, floor = rng.normal(size=(windows, 1, 6)) * np.arange(1, 7), np.full((1, 6), 1e-3)
    whole = gaussian(residuals, floor)
    white = whole.whiten(residuals)
    for window in (0, windows - 1):
        others = gaussian(np.delete(residuals, window, axis=0), floor)
        assert np.count_nonzero(others.noises[0].whitener) == (36 if windows == 80 else 6)
        exact = others.noises[0].whitener @ others.noises[0].whitener.T @ residuals[window, 0]
        found = whole.noises[0].whitener @ whole.pulls_without(white)[window, 0]
        assert found * (windows - 1) / windows == pytest.approx(exact, rel=1e-5)  # tails of a Gaussian: 1e6 degrees


def gaussian(residuals, floor):
    """A scatter that is the mean of squares."""
    flat = residuals[:, 0]
    full = len(flat) >= 5 * flat.shape[1]
    squares = flat.T @ flat / len(flat)
    values, vectors = np.linalg.eigh(squares if full else np.diag(np.diag(squares)))
    return Scatter((Student(vectors / np.sqrt(values), GAUSSIAN),), floor)


def test_a_window_that_alone_tells_a_parameter_leaves_the_prior():
    """Without it the parameter goes as far as the prior lets it; no division by nothing."""
    scatter = learn_scatter(np.random.default_rng(0).normal(size=(400, 1, 4)), 0, np.full((1, 4), 1e-3))
    slopes = np.zeros((2, 30, 1, 4))
    slopes[0], slopes[1, 3] = 1.0, 1e9
    residuals = np.full((30, 1, 4), 0.1)
    moves = moves_without(scatter, residuals, slopes, 4 * np.eye(2))
    assert np.isfinite(moves).all()
    assert abs(moves[3, 1]) > 1e6
    assert np.abs(np.delete(moves[:, 1], 3)).max() < 1e-6


@pytest.mark.parametrize(("rows", "shared"), [(1500, False), (500, False), (45, True)])
def test_no_window_ends_where_another_starts(rows, shared):
    """The noise of that row would be in both, and errors would be half as large again as is said.

    Of four times 45 rows, windows of four steps a row apart would be too few.
    """
    steps = np.arange(rows)
    state = np.random.default_rng(0).normal(size=(4, rows, 1))
    data = Dataset([Episode(str(i), 0.01 * steps, s, s, np.zeros((rows, 0))) for i, s in enumerate(state)])
    cut = cut_recordings(data, 0, 0, 160)
    for half in (cut.fit, cut.held):
        starts, ends = ({*zip(half.episode, half.row + h, strict=True)} for h in (0, half.horizon))
        assert len(half) >= 20
        assert bool(starts & ends) == shared


def test_a_scatter_that_is_one_window_alone_stays_finite():
    """One window a million times as large as all others makes up the scatter; what it pulls is large, not infinite."""
    residuals = np.full((30, 1, 2), 1e-3) * np.random.default_rng(0).normal(size=(30, 1, 2))
    residuals[4] = 1e3
    scatter = gaussian(residuals, np.full((1, 2), 1e-9))
    assert np.isfinite(scatter.pulls_without(scatter.whiten(residuals))).all()
