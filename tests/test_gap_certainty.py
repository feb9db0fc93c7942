"""How well values are known: on straight problems what slopes say, on rough ones what estimates really scatter by."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nfpde.gap.certainty import standard_errors
from nfpde.gap.fit import PRIOR, Fitter
from nfpde.gap.noise import learn_scatter
from nfpde.gap.replay import Replay
from nfpde.gap.trial import Court

WINDOWS = 60
ANYTHING: Any = None


class Bumpy(Replay):
    """Residuals A xi - b (two degrees of freedom of four channels) that jump whenever a parameter enters a new cell.

    Both halves of the recordings have an A and a b of their own; which, the windows say: 0 or 1.
    """

    effects = ()

    def __init__(self, halves, jumps, cell, seed):
        self.halves, self.jumps, self.cell, self.seed = halves, jumps, cell, seed
        self.low, self.high = np.full(2, -4.0), np.full(2, 5.0)

    def residuals(self, xi, windows, horizons, force=None):
        half: Any = windows
        matrix, target = self.halves[half]
        jumps = [self._jump(row, half, len(target)) for row in xi]
        return (xi @ matrix.T - target + self.jumps * np.array(jumps)).reshape(len(xi), -1, 2, 4)

    def _jump(self, row, half, size):
        cells = np.floor((row + 4.0) / self.cell).astype(int)
        drawn = [np.random.default_rng([self.seed, half, i, c]).normal(size=size) for i, c in enumerate(cells)]
        return np.sum(drawn, axis=0)


class Wavy(Bumpy):
    """The same, but what happens between contacts is smooth: a pit has a parabola's walls, and slopes to believe."""

    def _jump(self, row, half, size):
        rng = np.random.default_rng([self.seed, half])
        waves, phases = rng.normal(size=(size, 2)), rng.uniform(0.0, 2 * np.pi, size)
        return 2.0**0.5 * np.sin(waves @ row / self.cell + phases)


def fitted(seed, jumps=0.0, cell=1e-3, slopes=(1.0, 1.0), kind=Bumpy, looks=0):
    """A court and the fit to one half; the truth is 0.5 for both parameters, noise is 1.

    Fits begin beside it, or at the best of some looks around it.
    """
    rng = np.random.default_rng(seed)
    floor = np.full((2, 4), 1e-3)
    scatter = learn_scatter(rng.normal(size=(4000, 2, 4)), 0, floor)
    halves = []
    for _ in range(2):
        a = rng.normal(size=(WINDOWS * 8, 2)) * slopes
        halves.append((a, a @ [0.5, 0.5] + rng.normal(size=len(a))))
    replay = kind(halves, jumps, cell, seed)
    first: Any = 0
    second: Any = 1
    fitter = Fitter(first, (1, 2))
    begin = rng.normal(0.5, 0.3, size=(looks, 2)) if looks else np.array([[0.45, 0.55]])
    fit = fitter.improve(fitter.start(replay, begin, scatter), 10)
    return Court(ANYTHING, fitter, Fitter(second, (1, 2)), floor, fit.xi, ANYTHING), fitter.linearise(fit)


def test_where_nothing_jumps_slopes_are_right():
    """Never less than they foretell, and more only as far as the other half knows less, by chance."""
    for seed in range(10):
        court, fit = fitted(seed)
        ratio = standard_errors(court, fit) / fit.standard_errors
        assert (ratio >= 1.0).all()
        assert ratio == pytest.approx(1.0, abs=0.3)  # the sandwich's own error is 10 %, that of the slopes 7 %


@pytest.mark.parametrize(("jumps", "cell"), [(0.15, 2e-3), (0.05, 2e-3), (0.15, 2e-2), (0.3, 5e-3)])
def test_where_it_jumps_errors_are_no_larger_than_they_say(jumps, cell):
    """Slopes of one cell say nothing of the next: by them estimates are a dozen standard errors off and more.

    Fits end in the first pit that holds them, and how far from the truth that is depends on where they began; so the
    errors may be smaller than stated, but not by another order of magnitude.
    """
    local, stated = [], []
    for seed in range(40):
        court, fit = fitted(seed, jumps, cell)
        local.append((fit.xi - 0.5) / fit.standard_errors)
        stated.append((fit.xi - 0.5) / standard_errors(court, fit))
    by_slopes, ratio = (float(np.sqrt(np.mean(np.square(x)))) for x in (local, stated))
    assert by_slopes > 10.0
    assert 0.1 < ratio < 1.0 + 4 / np.sqrt(2 * 80)  # four standard errors of a root mean square of 80 ratios
    assert np.abs(stated).max() < 4.0


@pytest.mark.parametrize(("jumps", "cell"), [(0.3, 1e-3), (1.0, 1e-3), (1.0, 1e-2), (2.0, 3e-3)])
def test_the_walls_of_a_pit_are_no_rise_that_lasts(jumps, cell):
    """They are as steep as slopes foretell up to dozens of nats: where that ends others lie beside it.

    The best of some looks lies within reach of the truth, and the pit that it leads to has nothing to do with it.
    """
    local, stated = [], []
    for seed in range(40):
        court, fit = fitted(seed, jumps, cell, kind=Wavy, looks=64)
        local.append((fit.xi - 0.5) / fit.standard_errors)
        stated.append((fit.xi - 0.5) / standard_errors(court, fit))
    by_slopes, ratio = (float(np.sqrt(np.mean(np.square(x)))) for x in (local, stated))
    assert by_slopes > 100.0
    assert 0.1 < ratio < 1.0 + 4 / np.sqrt(2 * 80)
    assert np.abs(stated).max() < 4.0


@pytest.mark.parametrize("slope", [1.0, 1e9])
def test_what_nothing_tells_is_known_as_well_as_the_prior(slope):
    """Not better, as a sandwich without any score would have it, and not worse; beside what is known exactly, too."""
    court, fit = fitted(0, slopes=(slope, 0.0))
    errors = standard_errors(court, fit) / (fit.replay.high - fit.replay.low)
    assert errors[1] == pytest.approx(PRIOR, rel=0.05)
    assert errors[0] < 0.02


class Tilted(Replay):
    """A slope that is read as it is, and one across it, of which only what its cosine takes from gravity is seen.

    At none at all the second has no slope itself.
    """

    effects = ()

    def __init__(self, readings):
        self.readings = readings
        self.low, self.high = np.full(2, -0.5), np.full(2, 0.5)

    def residuals(self, xi, windows, horizons, force=None):
        half: Any = windows
        shown = np.stack([xi[:, 0] + 0.0 * xi[:, 1], np.cos(xi[:, 1])], axis=-1)
        return shown[:, None, None] - self.readings[half]


def test_what_only_becomes_steeper_says_nothing_of_jumps():
    """The slope is known as well as it is read many times; the one across no better than the cosine tells."""
    rng = np.random.default_rng(0)
    noise, floor = 1e-4, np.full((1, 2), 1e-9)
    readings = [[0.03, 1.0] + noise * rng.normal(size=(WINDOWS, 1, 2)) for _ in range(2)]
    scatter = learn_scatter(noise * rng.normal(size=(4000, 1, 2)), 0, floor)
    halves: Any = (0, 1)
    fitter, held = (Fitter(half, (1,)) for half in halves)
    replay: Any = Tilted(readings)
    fit = fitter.improve(fitter.start(replay, np.array([[0.02, 0.0]]), scatter), 10)
    errors = standard_errors(Court(ANYTHING, fitter, held, floor, fit.xi, ANYTHING), fitter.linearise(fit))
    assert errors[0] == pytest.approx(noise / WINDOWS**0.5, rel=0.4)  # of so few readings, a jackknife
    assert noise**0.5 / WINDOWS**0.25 < errors[1]


class Steep(Replay):
    """Residuals of a threshold: they change within a thousandth of the bounds, and nowhere else."""

    effects, width = (), 1e-3

    def __init__(self):
        self.low, self.high = np.zeros(2), np.ones(2)

    def residuals(self, xi, windows, horizons, force=None):
        off = np.stack([np.tanh((xi[:, 0] - 0.3) / self.width), xi[:, 1] - 0.3], axis=-1)
        return np.tile(off[:, None, None], (1, WINDOWS, 1, 1))


def test_slopes_are_taken_over_steps_that_their_own_errors_ask_for():
    """Whatever was believed before: over the widest step a threshold is all but flat, and its error ten times as large.

    A second parameter that the windows tell to a hundredth keeps its step.
    """
    steep, fitter = Steep(), Fitter(ANYTHING, (1,))
    sigma = 0.1
    scatter = learn_scatter(sigma * np.random.default_rng(0).normal(size=(4000, 1, 2)), 0, 1e-3 * np.ones((1, 2)))
    start = fitter.start(steep, np.array([[0.3, 0.3]]), scatter)
    exact = np.sqrt(WINDOWS) * np.array([1 / steep.width, 1.0]) / sigma
    crude = np.sqrt(np.diag(fitter.linearise(start).information))
    assert crude[0] < 0.1 * exact[0]
    for believed in (1.0, 1e4, 1e12):
        fit = fitter.resolved(replace(start, information=believed * np.eye(2)))
        found = np.sqrt(np.diag(fit.information))
        # of a tanh over .3 standard errors nothing is missing; the scatter is learnt of 4000, and its tails are a guess
        np.testing.assert_allclose(found, exact, rtol=0.1)
        assert fit.fresh == 0


class Stairs(Steep):
    """Steps of a five-hundredth of the bounds: a narrow step sees nothing of the slope that they follow."""

    width = 2e-3

    def residuals(self, xi, windows, horizons, force=None):
        off = np.stack([self.width * np.round((xi[:, 0] - 0.3) / self.width), xi[:, 1] - 0.3], axis=-1)
        return np.tile(off[:, None, None], (1, WINDOWS, 1, 1))


def test_steps_that_find_no_end_do_not_end_where_nothing_is_seen():
    """Of widths that lead to each other in turn, those count that tell most."""
    stairs, fitter, sigma = Stairs(), Fitter(ANYTHING, (1,)), 1e-3
    scatter = learn_scatter(sigma * np.random.default_rng(0).normal(size=(4000, 1, 2)), 0, 1e-5 * np.ones((1, 2)))
    start = fitter.start(stairs, np.array([[0.3, 0.3]]), scatter)
    exact = np.sqrt(WINDOWS) / sigma
    for believed in (1.0, 1e4, 1e12):
        fit = fitter.resolved(replace(start, information=believed * np.eye(2)))
        # a chord that ends on the first stair's edge is twice as steep as the stairs, and none that sees any is flatter
        ratio = np.sqrt(np.diag(fit.information)) / exact
        assert ((ratio > 0.9) & (ratio < 2.1)).all()
