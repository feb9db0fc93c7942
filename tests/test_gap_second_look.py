"""A second look at what was accepted earlier: every effect but the newest is looked at, whatever stood before it."""

from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.accepted import Accepted, key
from nfpde.gap.select import Selection

ANYTHING: Any = None
EFFECTS = [effect("viscous_damping", joint, damping=(0.0, 1.0)) for joint in "abc"]


def trial(one) -> Any:
    return SimpleNamespace(effect=one, density=np.zeros(8))


class Looking(Selection):
    """A selection that finds every effect again, but for one that is gone; the newest stands last in its model."""

    names: ClassVar[list[str]]
    looked: ClassVar[list[str]]
    gone: ClassVar[str | None]

    def without(self, trial, index) -> Any:
        self.looked.append(self.names[index])
        return SimpleNamespace(without=self.names.pop(index))

    def again(self, smaller, trials) -> Any:
        return smaller

    def accept(self, current: Any, trials, first_gap, level=0.0, settled=None) -> Any:
        name = current.without
        if name == self.gone:
            return None
        self.names.append(name)
        one = next(e for e in EFFECTS if key(e)[1] == name)
        return trial(one), Accepted(one, trial(one), (), (), ())


@pytest.mark.parametrize("dropped", [None, "a", "b"])
def test_every_earlier_effect_is_looked_at_once(dropped):
    """Of three that stand the first two are asked about; where one falls what is left is the answer."""
    Looking.names, Looking.looked, Looking.gone = [*"abc"], [], dropped
    court: Any = SimpleNamespace(block=np.arange(8))
    selection = Looking(ANYTHING, None, 1, court, [], yardstick=ANYTHING)
    accepted = [Accepted(e, trial(e), (), (), ()) for e in EFFECTS]
    _, left = selection._second_look(trial(EFFECTS[-1]), accepted, 1.0)
    assert Looking.looked == (["a"] if dropped == "a" else ["a", "b"])
    assert sorted(key(a.effect)[1] for a in left) == [n for n in "abc" if n != dropped]
    assert [key(a.effect)[1] for a in left] == Looking.names  # the report's order is the model's
