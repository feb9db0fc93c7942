"""Effects of earlier commands that windows at the beginnings of episodes told, and the others show too little of."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.accepted import Accepted
from nfpde.gap.found import Found
from nfpde.gap.remembered import with_remembered

ANYTHING: Any = None
LAG = effect("actuator_lag", "all", time_constant=(0.0, 0.1))
DELAY = effect("actuation_delay", "all", delay=(0.0, 0.1))
LIMIT = effect("torque_limit", "bend", limit=(0.1, 9.0))
DAMPING = effect("viscous_damping", "elbow", damping=(0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Shown:
    """What a model leaves: its gap, in noise floors, and the log density of what no fit saw."""

    effect: Any
    gap: float
    density: float = 0.0


def accepted(which, *rivals):
    trial: Any = Shown(which, 1.0)
    others: Any = tuple(Shown(r, 1.0) for r in rivals)
    return Accepted(which, trial, others, (), ())


@dataclass(eq=False)
class Asked:
    """A selection that knows what each effect leaves when it is added."""

    left: dict[str, Shown]
    sigma: Any = None
    most: int = 3

    court = SimpleNamespace(gain=lambda better, base: (better.density - base.density, 1.0, 0.5))

    def gap_of(self, trial):
        return trial.gap

    def floor(self, trial):
        return 1.0

    def again(self, smaller, trials):
        return [self.left[t.effect.name] for t in trials if t.effect.name in self.left]

    def linear(self, trial, *, fitted):
        return trial


def found(final, names, left, **more):
    chosen: Any = Asked(left, **more)
    return Found(ANYTHING, ANYTHING, chosen, final, names, False)


BETTER = {"actuator_lag": Shown(LAG, 1.02, 0.1), "actuation_delay": Shown(DELAY, 1.03, 0.05)}


@pytest.mark.parametrize(
    ("early", "told", "without", "left", "named"),
    [
        (1.2, LAG, [LIMIT], BETTER, True),
        (1.2, LAG, [], BETTER, True),
        (1.7, LAG, [LIMIT], BETTER, False),  # the beginnings are not explained
        (1.2, DAMPING, [LIMIT], {"viscous_damping": Shown(DAMPING, 1.0, 0.2)}, False),  # it remembers nothing
        (1.2, LAG, [DELAY], BETTER, False),  # its equal was found
        (1.2, LAG, [LIMIT], {"actuator_lag": Shown(LAG, 1.02, -0.1)}, False),  # foretold worse
        (1.2, LAG, [LIMIT], {"actuator_lag": Shown(LAG, 1.06, 0.1)}, False),  # more is left
        (1.2, LAG, [LIMIT], {}, False),  # not a few nats for it where it was fitted
        (1.2, LAG, [LIMIT, DAMPING, DAMPING], BETTER, False),  # there is no place for more
    ],
)
def test_what_the_beginnings_told_stays_where_the_rest_agrees(early, told, without, left, named):
    """Where they are explained, and neither half of the rest speaks against it."""
    rivals = [DELAY] if told is LAG else []
    first = found(Shown(told, early), [accepted(told, *rivals)], {})
    rest = found(Shown(None, 1.05), [accepted(e) for e in without], left)
    both = with_remembered(first, rest)
    assert [a.effect for a in both.accepted] == [*without, *([told] if named else [])]
    if named:
        assert both.final is left["actuator_lag"]
        assert [t.effect for t in both.accepted[-1].rivals] == [DELAY]
    else:
        assert both is rest


def test_beside_contacts_beginnings_are_not_asked():
    """There a robot that was let go falls on what it stands on."""
    first = found(Shown(LAG, 1.2), [accepted(LAG, DELAY)], {})
    rest = found(Shown(None, 1.05), [], BETTER, sigma=np.ones(4))
    assert with_remembered(first, rest) is rest
