"""A share between following a mass and not following it may be a pit of the likelihood: both ends are tried."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.gap.ends import at_ends
from nfpde.gap.inertia import NAME
from nfpde.gap.trial import LEAST_GAIN

MASS, SHARE = SimpleNamespace(field="body_mass", low=0.5, high=2.0), SimpleNamespace(field=NAME, low=0.0, high=1.0)


class Pits:
    """A court whose fits roll into the nearest of some pits of the last parameter, the mass being what it is.

    pits: places and their costs
    apart: what the place from which a fit starts costs more than the bottom of the deepest
    """

    def __init__(self, apart: float = 100.0, **pits: float) -> None:
        self.apart = apart
        self.pits = {float(place.strip("at_").replace("_", ".")): cost for place, cost in pits.items()}
        self.started: list[float] = []
        self.fitter: Any = SimpleNamespace(start=self.start, rescale=lambda fit, scatter: fit)

    def start(self, replay, xi, scatter):
        self.started.append(float(xi[0, -1]))
        return fit(replay, xi[0], min(self.pits.values()) + self.apart)

    def scatter(self, fit):
        return None

    def converged(self, there):
        place = min(self.pits, key=lambda p: abs(p - there.xi[-1]))
        return fit(there.replay, np.append(there.xi[:-1], place), self.pits[place])


def fit(replay, xi, cost) -> Any:
    return SimpleNamespace(replay=replay, xi=xi, cost=cost, scatter=None)


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
    replay = SimpleNamespace(parameters=(MASS, SHARE))
    there = at_ends(court, fit(replay, np.array([0.7, 0.6]), 5.0))
    assert court.started == [0.0, 1.0]
    np.testing.assert_array_equal(there.xi, [0.7, found])


@pytest.mark.parametrize(("apart", "found"), [(-1.0, 1.0), (0.9 * LEAST_GAIN, 0.6), (1.1 * LEAST_GAIN, 1.0)])
def test_an_end_that_the_recordings_do_not_tell_from_the_fit_is_not_fitted(apart, found):
    """A body that never turns costs the same with any inertia; one that is better off there goes on from there."""
    court: Any = Pits(apart, at_0=9.0, at_0_6=5.0, at_1=5.0 - 1e-9)
    replay = SimpleNamespace(parameters=(MASS, SHARE))
    there = at_ends(court, fit(replay, np.array([0.7, 0.6]), 5.0))
    np.testing.assert_array_equal(there.xi, [0.7, found])


@pytest.mark.parametrize(("end", "other"), [(0.0, 1.0), (1.0, 0.0)])
def test_a_fit_that_ended_at_an_end_is_tried_from_the_other_alone(end, other):
    court: Any = Pits(at_0=4.0, at_1=4.0)
    replay = SimpleNamespace(parameters=(MASS, SHARE))
    there = at_ends(court, fit(replay, np.array([0.7, end]), 4.0))
    assert court.started == [other]
    np.testing.assert_array_equal(there.xi, [0.7, end])


def test_nothing_is_fitted_where_no_inertia_may_follow():
    """A mass alone has no ends that are likelier than what lies between."""
    court: Any = Pits(at_1=0.0)
    there = fit(SimpleNamespace(parameters=(MASS,)), np.array([0.7]), 5.0)
    assert at_ends(court, there) is there
    assert court.started == []
