"""All short windows are searched where noise beside contacts may leave as much as there is."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.acceptance import LEAST_GAP
from nfpde.gap.brief import EVERY, brief
from nfpde.gap.found import Earlier
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.search import Search
from nfpde.gap.trial import LEVEL
from tests.test_gap_again import ANYTHING, SOFT, Leaving
from tests.test_gap_contacts import pushes

DELAY = effect("viscous_damping", "along", damping=(0.0, 1.0))
FOUND: Any = SimpleNamespace(effect=DELAY)


@pytest.mark.parametrize(
    ("left", "again", "found", "longest", "every", "longer"),
    [
        (1.0, False, [], 1.0, True, True),  # nothing was found: the longest are asked as well
        (1.0, False, [FOUND], 1.0, True, False),  # what was found stands
        (1.0, False, [FOUND], 9.0, False, True),  # longer windows show more than noise: they are asked what it is
        (9.0, False, [], 1.0, False, True),  # some single steps show it
        (9.0, False, [FOUND], 1.0, False, True),
        (0.9 * LEAST_GAP, False, [], 1.0, False, True),  # nobody asks
        (1.0, True, [], 1.0, False, True),  # all were asked before
    ],
)
def test_all_short_windows_are_searched_near_noise(left, again, found, longest, every, longer, monkeypatch):
    """In windows of one step, then longer ones, each searched once; near noise only the longest of these."""
    recordings = cut_recordings(pushes(0.5, rows=800), 0, 0, 60)
    part = "nfpde.gap.search."
    monkeypatch.setattr(part + "first_fit", lambda *args, **options: ("base", court))
    monkeypatch.setattr(part + "moved_over", lambda base, court, there: ("base", court))
    monkeypatch.setattr(part + "gaps", lambda *args: np.ones(60))
    monkeypatch.setattr(part + "alike_halves", lambda *args: None)
    monkeypatch.setattr(part + "best_beginning", lambda selection, base, final, accepted: (final, accepted))
    monkeypatch.setattr(part + "Far", lambda *args: ANYTHING)
    searched, court = [], SimpleNamespace(capped=ANYTHING)

    def stage(there: Any) -> Any:
        def shown(final: Any, refitted: bool) -> Any:
            return final

        fit = SimpleNamespace(fit=ANYTHING)
        return SimpleNamespace(
            court=ANYTHING, yardstick=there, base=fit, sigma=np.ones(2), misjudged=1.0, recordings=there, shown=shown
        )

    monkeypatch.setattr(part + "in_noise", lambda base, court, there, *args, **options: stage(there))

    class Near(Leaving):
        def gap_of(self, trial):
            there: Any = self.yardstick
            return left if there.horizons == (1,) else longest

    class Asking(Search):
        def cut(self, lead=None, held=None):
            return recordings

        def after(self, before, longer, known, **options) -> Any:
            return stage(longer)

        def _history(self):
            return 0, 0, 0

        def _may_hide(self, near, selection, final):
            return False

        def _select(self, near, selection, earlier=None, *, further=False) -> Any:
            searched.append((near.recordings, selection.below, selection.level))
            return near, selection, SimpleNamespace(fit=ANYTHING), found

    def select(near: Any) -> Any:
        return Near(ANYTHING, None, 1, ANYTHING, [], yardstick=near.recordings, sigma=np.ones(2))

    data: Any = SimpleNamespace(control_dt=0.01)
    search = Asking(ANYTHING, data, [(SOFT, np.ones((1, 2)))], np.zeros((1, 0)), 160, 0, select, lambda what: None)
    if again:
        search = replace(search, before=Earlier(None, False, 1.0, np.zeros(0), LEVEL / 4))
    found_there = search._run(early=False)
    assert found_there.every is every  # then nothing is left to look at once more
    some, all_steps = (brief(recordings, *most) for most in ((), (EVERY,)))
    assert len(some[0].fit) < len(all_steps[0].fit)
    assert len(some) == 3
    lengths = (all_steps[::2] if every else some)[: None if longer else 1]
    assert [below for _, below, _ in searched] == [every] + [False] * (len(lengths) - 1)
    first = LEVEL / (8 if again else 2)
    assert [level for *_, level in searched] == [first / 2**look for look in range(len(lengths))]
    assert [(s.horizons, len(s.fit)) for s, *_ in searched] == [(s.horizons, len(s.fit)) for s in lengths]


@pytest.mark.parametrize(("below", "last", "accepted", "nothing"), [
    (True, False, [], False),  # a first effect is asked for
    (True, False, [FOUND], False),  # and a second one
    (True, False, [FOUND, FOUND], True),  # a third one is not
    (False, False, [FOUND, FOUND], True),
    (False, True, [FOUND, FOUND], False),
    (False, False, [], True),  # some steps do not tell
    (False, False, [FOUND], False),  # beside an effect no others are asked
    (False, True, [], False),
])  # fmt: skip
def test_below_the_floor_of_noise_all_single_steps_are_asked(below, last, accepted, nothing):
    chosen = Leaving(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2), last=last, below=below)
    assert chosen._nothing_left(ANYTHING, accepted) is nothing
