"""A likelihood that is a funnel with rough walls: slopes end at the next bump, a population sees over them."""

from typing import Any

import numpy as np
import pytest

from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.funnel import LOOKS, down_the_funnel, population
from nfpde.gap.noise import learn_scatter
from nfpde.gap.trial import LEAST_GAIN, Court

ANYTHING: Any = None
WINDOWS = 200


class Rough:
    """A load: its mass and place do nearly the same, and contacts open and close at every thousandth of a change.

    A window's residuals are linear in the parameters, and beside that jump about, as they do where wheels roll.
    """

    nfree, parameters, nv, effects = 3, (), 1, ()

    def __init__(self, bumps: float) -> None:
        rng = np.random.default_rng(1)
        self.bumps, self.asked = bumps, 0
        self.slopes = rng.normal(size=(WINDOWS, 2, 3)) @ np.array([[1.0, 0.9, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 1.0]])
        self.waves, self.phase = 1e3 * rng.normal(size=(WINDOWS, 2, 3)), rng.uniform(0, 2 * np.pi, (WINDOWS, 2))
        self.noise = rng.normal(size=(WINDOWS, 2))
        self.truth = self.elsewhere = np.array([0.5, 0.4, 0.6])

    def inward(self, xi: np.ndarray) -> np.ndarray:
        return np.clip(xi, 0.0, 1.0)

    outward = inward

    def residuals(self, xi, windows, horizons, force=None):
        self.asked += len(xi)
        truth = self.elsewhere if windows[0] < 0 else self.truth
        linear = np.einsum("nci,gi->gnc", self.slopes, 100 * (xi - truth))
        rough = self.bumps * np.sin(np.einsum("nci,gi->gnc", self.waves, xi) + self.phase)
        return (linear + rough + self.noise)[:, np.abs(windows) - 1, None]


def fitted(replay: Any, start: list[float]) -> tuple[Court, Fit]:
    """A fit by slopes from a place, and the court that made it."""
    windows: Any = 1 + np.arange(WINDOWS)
    others: Any = -windows
    fitter, held, floor = Fitter(windows, (1,)), Fitter(others, (1,)), np.full((1, 2), 1e-6)
    xi = np.array([start])
    scatter = learn_scatter(fitter.residuals_at(replay, xi)[0], 0, floor)
    court = Court(np.arange(WINDOWS), fitter, held, floor, np.zeros(3), ANYTHING, 0.02)
    return court, court.converged(fitter.start(replay, xi, scatter))


@pytest.mark.parametrize("start", [[0.45, 0.45, 0.6], [0.55, 0.4, 0.65], [0.5, 0.35, 0.55]])
def test_a_population_sees_over_bumps(start):
    """Slopes end dozens of nats above the truth; from there a population comes as near as bumps allow."""
    replay: Any = Rough(bumps=2.0)
    court, stuck = fitted(replay, start)
    found = down_the_funnel(court, stuck)
    there = court.fitter.start(replay, replay.truth[None], found.scatter)
    above = court.fitter.rescale(stuck, found.scatter).cost - there.cost
    assert above > 4 * LEAST_GAIN
    # one place of hundreds may be better than the truth by chance
    assert found.cost - there.cost < 0.25 * above
    # along the valley in which two parameters do nearly the same, bumps decide
    assert np.abs(found.xi - replay.truth).max() < 0.5 * np.abs(stuck.xi - replay.truth).max()


def test_in_smooth_motion_it_looks_once_and_leaves_the_fit_alone():
    replay: Any = Rough(bumps=0.0)
    court, fit = fitted(replay, [0.45, 0.45, 0.6])
    asked = replay.asked
    assert down_the_funnel(court, fit) is fit
    assert replay.asked - asked == 3 + population(3) * len(LOOKS)  # slopes, and looks
    again = court.fitter.start(replay, replay.truth[None], fit.scatter)
    assert fit.cost <= again.cost + LEAST_GAIN


@pytest.mark.parametrize(("share", "stands"), [(1.0, True), (0.9, True), (0.65, False), (0.0, False)])
def test_the_half_that_no_fit_saw_must_agree(share, stands):
    """Where its truth lies on the way to that of the other half: of what that gains, (2 share - 1), it gains itself.

    At none it shows the end of the slopes to be right, and a better place in the other half is one of chance.
    """
    replay: Any = Rough(bumps=2.0)
    court, stuck = fitted(replay, [0.45, 0.45, 0.6])
    assert down_the_funnel(court, stuck) is not stuck
    replay.elsewhere = stuck.xi + share * (replay.truth - stuck.xi)
    assert (down_the_funnel(court, stuck) is not stuck) is stands


def test_random_numbers_of_others_stay_as_they_are():
    """The same every time, and numpy's global generator is left alone."""
    state = repr(np.random.get_state())  # noqa: NPY002
    one, other = (down_the_funnel(*fitted(Rough(bumps=2.0), [0.45, 0.45, 0.6])) for _ in range(2))
    assert one.xi.tolist() == other.xi.tolist()
    assert repr(np.random.get_state()) == state  # noqa: NPY002


def test_nothing_free_is_nothing_to_search():
    bare: Any = type("Bare", (), {"nfree": 0})()
    fit: Any = type("Fixed", (), {"replay": bare})()
    assert down_the_funnel(ANYTHING, fit) is fit
