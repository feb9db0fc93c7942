"""Where some of the short windows show nothing, all of them are looked at."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.brief import EVERY, MOST, brief
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.search import Search
from tests.test_gap_contacts import pushes

ANYTHING: Any = None
SOFT = effect("contact_softness", time_constant=(0.004, 0.2), damping_ratio=(0.1, 4.0))
FAST = effect("viscous_damping", "along", damping=(0.0, 1.0))


@pytest.mark.parametrize(
    ("what", "rows", "accepted", "at_floor", "again"),
    [
        (SOFT, 400, [], True, True),
        (SOFT, 400, ["found"], True, False),  # what is there was found
        (SOFT, 400, [], False, False),  # far more than noise: more windows explain no more of it
        (SOFT, 120, [], True, False),  # all windows were looked at
        (FAST, 400, [], True, False),  # nothing touches anything: windows are long, and all that there are
    ],
)
def test_all_short_windows_are_looked_at_where_some_show_nothing(what, rows, accepted, at_floor, again, monkeypatch):
    recordings = cut_recordings(pushes(0.5, rows=rows), 0, 0, 160)
    used = []

    def to_the_end(search: Search) -> tuple[Any, Any]:
        used.append(search.most)
        selection = SimpleNamespace(at_floor=lambda trial: at_floor, steps=len(used))
        found = SimpleNamespace(accepted=accepted, recordings=recordings, selection=selection, final=ANYTHING)
        return "stage", found

    monkeypatch.setattr(Search, "_to_the_end", to_the_end)
    told = []
    search = Search(ANYTHING, ANYTHING, [(what, np.ones((1, 2)))], np.zeros((1, 0)), 160, 0, ANYTHING, told.append)
    stage, found = search.run()
    assert used == ([MOST, EVERY] if again else [MOST])
    assert stage == "stage"
    assert len(told) == again
    assert found.selection.steps == (3 if again else 1)  # what both simulated counts


def test_more_windows_are_more_of_the_same():
    """All that the longest windows hold, in order; the fewer are among them."""
    recordings = cut_recordings(pushes(0.5, rows=400), 0, 0, 160)
    for some, every in zip(brief(recordings), brief(recordings, EVERY), strict=True):
        steps = some.horizons[-1]
        assert every.horizons == some.horizons
        assert len(every.fit) == min(round(EVERY / steps**0.5), len(recordings.fit) * (recordings.fit.horizon // steps))
        where = {(e, r) for e, r in zip(every.fit.episode, every.fit.row, strict=True)}
        assert {(e, r) for e, r in zip(some.fit.episode, some.fit.row, strict=True)} <= where
        assert len(where) == len(every.fit)
    assert len(brief(recordings)[0].fit) < len(brief(recordings, EVERY)[0].fit)
