"""The score test of held-out windows, on straight problems with a known answer."""

from typing import Any

import numpy as np
import pytest

from nfpde.estimation.trajectory.student import GAUSSIAN, Student
from nfpde.gap.fit import Fitter
from nfpde.gap.noise import Scatter
from nfpde.gap.score import HeldScore
from nfpde.gap.trial import Court, Trial, block_test
from tests.gap_straight import Straight

WINDOWS, BLOCK, CHANNELS = 120, 5, 6
BLOCKS = np.repeat(np.arange(WINDOWS // BLOCK), BLOCK)
ANYTHING: Any = None


def trials(matrix, change, target, xi, size):
    """Court, model and candidate on held-out windows: the parameters at xi, the candidate's size as another half said.

    Returns:
        Court, trial of the model and of the candidate; densities are those of unit noise.
    """
    replay = Straight(matrix, target)
    fitter = Fitter(ANYTHING, (1, 2))
    unit = Scatter((Student(np.eye(CHANNELS), GAUSSIAN),), np.full((1, CHANNELS), 1e-3))
    court = Court(BLOCKS, fitter, fitter, np.full((1, CHANNELS), 1e-3), ANYTHING, ANYTHING)
    fit = fitter.linearise(fitter.start(replay, xi[None], unit))
    held = fit.residuals
    beside = held + size * change[:, None]
    return court, *(Trial(None, fit, unit.log_density(h), h, unit.log_density(h)) for h in (held, beside))


def drawn(rng, pull):
    """A problem with two parameters and a candidate that is `pull` standard errors of either half in size."""
    matrix = rng.normal(size=(WINDOWS, CHANNELS, 2))
    change = rng.normal(size=(WINDOWS, CHANNELS))
    scale = 1 / np.linalg.norm(change)
    other_half = pull + rng.normal()  # of the size that it was fitted to be there, in standard errors
    xi = 0.5 + rng.normal(size=2) / np.sqrt(WINDOWS * CHANNELS)
    target = matrix @ np.full(2, 0.5) + pull * scale * change + rng.normal(size=change.shape)
    return trials(matrix, change, target, xi, other_half * scale)


def test_rejects_what_is_not_there_as_seldom_as_it_says():
    """Of 400 problems without the candidate's effect; twice the smaller of two p-values errs to the safe side."""
    rng = np.random.default_rng(1)
    values = []
    for _ in range(400):
        court, current, trial = drawn(rng, 0.0)
        values.append(HeldScore(court, current).p_value(trial))
    for level in (0.02, 0.1, 0.3):
        most = 400 * level + 3 * np.sqrt(400 * level * (1 - level))
        assert np.count_nonzero(np.array(values) <= level) <= most


def test_finds_what_the_gain_in_density_cannot_tell():
    """Three standard errors in each half: at .01 the score's z, normal about 3, passes 2.58 in 66 % of cases.

    That of the gain is normal about half of 3, as the size fitted to one half is wrong on the other, and passes in a
    sixth of them.
    """
    rng = np.random.default_rng(2)
    score, gain = [], []
    for _ in range(200):
        court, current, trial = drawn(rng, 3.0)
        score.append(HeldScore(court, current).p_value(trial) <= 0.01)
        gain.append(block_test(trial.density - current.density, BLOCKS)[2] <= 0.01)
    assert np.mean(score) > 0.5
    assert np.mean(gain) < 0.3


@pytest.mark.parametrize("own", [True, False])
def test_what_the_parameters_could_do_themselves_is_none_of_the_candidates(own):
    """Fitted to one half they are off on the other, ten standard errors here: a change like theirs gets no credit."""
    rng = np.random.default_rng(3)
    rejected, by_gain = 0, 0
    for _ in range(50):
        matrix = rng.normal(size=(WINDOWS, CHANNELS, 2))
        change = matrix[..., 0] if own else matrix[..., 0] + rng.normal(size=(WINDOWS, CHANNELS))
        target = matrix @ np.full(2, 0.5) + rng.normal(size=change.shape)
        off = 10 / np.sqrt(WINDOWS * CHANNELS)
        court, current, trial = trials(matrix, change, target, np.array([0.5 + off, 0.5]), -0.5 * off)
        rejected += HeldScore(court, current).p_value(trial) <= 0.01
        by_gain += block_test(trial.density - current.density, BLOCKS)[2] <= 0.01
    assert rejected <= 3  # of 50 at .01: more has a probability of .002
    assert by_gain > 25  # the case is one in which it matters


def test_a_jump_of_the_candidates_own_does_not_decide():
    """A foot that lands elsewhere in one window, by a million standard errors, hides nothing and proves nothing."""
    rng = np.random.default_rng(4)
    matrix, change = rng.normal(size=(WINDOWS, CHANNELS, 1)), rng.normal(size=(WINDOWS, CHANNELS))
    for pull in (0.0, 8.0):
        scale = 1 / np.linalg.norm(change)
        target = matrix[..., 0] * 0.5 + pull * scale * change + rng.normal(size=change.shape)
        court, current, trial = trials(matrix, change, target, np.array([0.5]), 5.0 * scale)
        before = HeldScore(court, current).p_value(trial)
        for jump in (1e6, np.nan):
            trial.held[7] = jump
            after = HeldScore(court, current).p_value(trial)
            assert (after <= 0.001) is (before <= 0.001) is (pull > 0)


def test_a_candidate_that_changes_nothing_is_not_asked_for():
    """All scores are zero: that is no evidence."""
    court, current, _ = drawn(np.random.default_rng(5), 3.0)
    assert HeldScore(court, current).p_value(current) == 1.0
