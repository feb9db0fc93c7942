"""A share between following a mass and not following it may be a pit of the likelihood: both ends are tried."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.gap.ends import FAR_FROM, FIRST, at_ends
from nfpde.gap.inertia import NAME
from nfpde.gap.trial import LEAST_GAIN

MASS, SHARE = SimpleNamespace(field="body_mass", low=0.5, high=2.0), SimpleNamespace(field=NAME, low=0.0, high=1.0)


@dataclass(frozen=True, eq=False)
class Place:
    """What is asked of a fit; a share is known to a thousandth by slopes."""

    replay: Any
    xi: np.ndarray
    cost: float
    scatter: Any = None
    slopes: Any = None
    known: bool = False
    information: Any = field(default_factory=lambda: np.diag([1e6, 1e6]))


class Pits:
    """A court whose fits roll into the nearest of some pits of the last parameter, the mass being what it is.

    pits: places and their costs
    apart: what the place from which a fit starts costs more than the bottom of the deepest
    left: of the way to a pit's bottom, after the first steps [nats]
    """

    def __init__(self, apart: float = 100.0, left: float = 1.0, **pits: float) -> None:
        self.apart, self.left = apart, left
        self.pits = {float(place.strip("at_").replace("_", ".")): cost for place, cost in pits.items()}
        self.started, self.ended = list[float](), list[float]()
        self.fitter: Any = SimpleNamespace(start=self.start, rescale=lambda fit, scatter: fit, improve=self.improve)

    def start(self, replay, xi, scatter):
        self.started.append(float(xi[0, -1]))
        return fit(replay, xi[0], min(self.pits.values()) + self.apart)

    def scatter(self, fit):
        return None

    def improve(self, there, steps, kept):
        assert (steps, kept, there.known) == (FIRST, 2, True)
        bottom = self._bottom(there)
        return replace(bottom, cost=bottom.cost + self.left)

    def converged(self, there):
        self.ended.append(there.xi[-1])
        return self._bottom(there)

    def _bottom(self, there):
        place = min(self.pits, key=lambda p: abs(p - there.xi[-1]))
        return fit(there.replay, np.append(there.xi[:-1], place), self.pits[place])


def fit(replay, xi, cost) -> Any:
    return Place(replay, xi, cost)


def replay_of(*parameters) -> Any:
    return SimpleNamespace(parameters=parameters, inward=lambda xi: xi)


@pytest.mark.parametrize(
    ("pits", "found"),
    [
        ({"at_0": 4.0, "at_0_6": 5.0, "at_1": 9.0}, 0.0),
        ({"at_0": 9.0, "at_0_6": 5.0, "at_1": 4.0}, 1.0),
        ({"at_0": 9.0, "at_0_6": 5.0, "at_1": 9.0}, 0.6),
        ({"at_0": 4.0, "at_0_6": 5.0, "at_1": 3.0}, 1.0),
    ],
)
def test_the_deepest_of_three_pits_is_found(pits, found):
    """Whatever the mass is, which is not moved."""
    court: Any = Pits(**pits)
    replay = replay_of(MASS, SHARE)
    there = at_ends(court, fit(replay, np.array([0.7, 0.6]), 5.0))
    assert court.started == [0.0, 1.0]
    np.testing.assert_array_equal(there.xi, [0.7, found])


@pytest.mark.parametrize(("apart", "found"), [(-1.0, 1.0), (0.9 * LEAST_GAIN, 0.6), (1.1 * LEAST_GAIN, 1.0)])
def test_an_end_that_the_recordings_do_not_tell_from_the_fit_is_not_fitted(apart, found):
    """A body that never turns costs the same with any inertia; one that is better off there goes on from there."""
    court: Any = Pits(apart, at_0=9.0, at_0_6=5.0, at_1=5.0 - 1e-9)
    replay = replay_of(MASS, SHARE)
    there = at_ends(court, fit(replay, np.array([0.7, 0.6]), 5.0))
    np.testing.assert_array_equal(there.xi, [0.7, found])


@pytest.mark.parametrize(
    ("cost", "left", "goes_on"),
    [
        (5.0, 1.0, True),  # as good, elsewhere
        (5.0 + 0.9 * FAR_FROM * 100, 0.0, True),  # worse, but less than what may still be gained
        (5.0 + 1.2 * FAR_FROM * 100, 0.0, False),
    ],
)
def test_what_first_steps_show_to_be_worse_is_not_fitted_to_the_end(cost, left, goes_on):
    court: Any = Pits(105.0 + cost - 5.0, left, at_0=cost, at_0_6=5.0)
    at_ends(court, fit(replay_of(MASS, SHARE), np.array([0.7, 0.6]), 5.0))
    assert court.started == [0.0, 1.0]
    assert court.ended == ([0.0] if goes_on else [])  # from one the way leads back to the fit


@pytest.mark.parametrize(("end", "other"), [(0.0, 1.0), (1.0, 0.0)])
def test_a_fit_that_ended_at_an_end_is_tried_from_the_other_alone(end, other):
    court: Any = Pits(at_0=4.0, at_1=4.0)
    replay = replay_of(MASS, SHARE)
    there = at_ends(court, fit(replay, np.array([0.7, end]), 4.0))
    assert court.started == [other]
    np.testing.assert_array_equal(there.xi, [0.7, end])


def test_nothing_is_fitted_where_no_inertia_may_follow():
    """A mass alone has no ends that are likelier than what lies between."""
    court: Any = Pits(at_1=0.0)
    there = fit(replay_of(MASS), np.array([0.7]), 5.0)
    assert at_ends(court, there) is there
    assert court.started == []
