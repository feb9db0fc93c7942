"""Windows that tell more of what was found than those on which it was found."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.gap.found import Found
from nfpde.gap.telling import asks_again, tells_more

ANYTHING: Any = None


def stage(errors: list[float]) -> Any:
    """A stage that knows two effects' values by so much: a size, and a size with a shape."""
    size, shape = SimpleNamespace(shape_only=False), SimpleNamespace(shape_only=True)
    effects = [SimpleNamespace(quantities=[size]), SimpleNamespace(quantities=[size, shape])]
    starts = [1, 2]
    replay = SimpleNamespace(effects=effects, columns=lambda i: slice(starts[i], None))
    court = SimpleNamespace(fitter=SimpleNamespace(resolved=lambda fit: fit), errors=np.array(errors))
    fit = SimpleNamespace(replay=replay)
    return SimpleNamespace(court=court, shown=SimpleNamespace(fit=fit))


@pytest.mark.parametrize(
    ("longer", "more"),
    [
        ([9.0, 0.7, 0.7, 9.0], True),  # 0.49 of the variance; parameters and shapes do not count
        ([0.1, 0.72, 0.72, 0.1], False),
        ([1.0, 0.1, 4.0, 1.0], True),  # a hundredth and sixteen: 0.4 in the mean
        ([1.0, 0.3, 2.0, 1.0], False),  # 0.6
    ],
)
def test_windows_tell_more_that_know_the_sizes_of_effects_by_half_the_variance(longer, more, monkeypatch):
    monkeypatch.setattr("nfpde.gap.telling.standard_errors", lambda court, fit: court.errors)
    near, far = stage([1.0] * 4), stage(longer)
    assert tells_more(far, far.shown, near, near.shown) is more


@pytest.mark.parametrize(
    ("rivals", "doubtful"),
    [([], False), ([((), ())], False), ([(("other",), ())], True), ([((), ("close",))], True), ([((), ())] * 2, True)],
)
def test_only_what_may_be_another_s_work_is_asked_again(rivals, doubtful):
    accepted: Any = [SimpleNamespace(rivals=equal, close=close) for equal, close in rivals]
    found = Found(ANYTHING, ANYTHING, ANYTHING, ANYTHING, accepted, early=False)
    assert found.doubtful is doubtful


@pytest.mark.parametrize(
    ("accepted", "rivals", "floor", "more", "asked"),
    [
        (1, (), True, True, False),
        (1, (), False, True, True),
        (1, ("other",), True, True, True),
        (1, ("other",), False, False, False),
        (0, (), False, True, False),
    ],
)
def test_windows_that_tell_more_are_asked_where_they_may_say_something_else(
    accepted, rivals, floor, more, asked, monkeypatch
):
    """Of a model without effects nothing is to be told apart, whatever it leaves."""
    monkeypatch.setattr("nfpde.gap.telling.tells_more", lambda *told: more)
    one: Any = SimpleNamespace(rivals=rivals, close=())
    found = Found(ANYTHING, ANYTHING, ANYTHING, ANYTHING, [one] * accepted, early=False)
    selection: Any = SimpleNamespace(at_floor=lambda trial: floor)
    assert asks_again(selection, ANYTHING, ANYTHING, found) is asked
