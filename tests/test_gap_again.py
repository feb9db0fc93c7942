"""Where some of the short windows show nothing, all of them are looked at."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.acceptance import LEAST_GAP
from nfpde.gap.brief import EVERY, MOST, brief, single_steps
from nfpde.gap.found import Found
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.search import Search
from nfpde.gap.select import Selection
from tests.test_gap_contacts import pushes

ANYTHING: Any = None
SOFT = effect("contact_softness", time_constant=(0.004, 0.2), damping_ratio=(0.1, 4.0))
FAST = effect("viscous_damping", "along", damping=(0.0, 1.0))
NEAR: Any = SimpleNamespace(misjudged="by how much", base=SimpleNamespace(fit=SimpleNamespace(xi=np.zeros(0))))


class Leaving(Selection):
    """A selection that knows what is left, beside a floor of one."""

    left, stands = 1.0, False

    def stands_out(self, trial):
        return self.stands

    def gap_of(self, trial):
        return self.left

    def floor(self, trial):
        return 1.0


@pytest.mark.parametrize(
    ("what", "rows", "accepted", "gap", "stands", "every", "again"),
    [
        (SOFT, 400, [], 1.0, False, False, True),
        (SOFT, 400, [], 1.0, False, True, False),  # all were looked at before
        (SOFT, 400, ["found"], 1.0, False, False, False),  # what is there was found
        # far more than noise: more windows explain no more of it, the other half may
        (SOFT, 400, [], 9.0, True, False, False),
        (SOFT, 400, [], 9.0, False, False, False),  # noise alone leaves as much now and then
        (FAST, 400, [], 9.0, False, False, False),  # in smooth motion its mean is known
        (SOFT, 400, [], 0.9 * LEAST_GAP, False, False, False),  # next to nothing is explained by no more
        (SOFT, 120, [], 1.0, False, False, False),  # there are no more
        (FAST, 400, [], 1.0, False, False, False),  # nothing touches anything: windows are long, and all that there are
    ],
)
def test_all_short_windows_are_looked_at_where_some_show_nothing(
    what, rows, accepted, gap, stands, every, again, monkeypatch
):
    recordings = cut_recordings(pushes(0.5, rows=rows), 0, 0, 160)
    used, knew, swapped = [], [], []

    def to_the_end(search: Search) -> tuple[Any, Any]:
        swapped.append(search.swapped)
        used.append(search.most)
        knew.append(search.before and search.before.misjudged)
        selection = Leaving(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2), steps=len(used))
        selection.left, selection.stands = gap, stands
        return "stage", Found(recordings, NEAR, selection, ANYTHING, accepted, early=False, every=every)

    monkeypatch.setattr(Search, "_to_the_end", to_the_end)
    alone = []
    monkeypatch.setattr(Search, "_by_free_joints", lambda search, *of: alone.append((used[-1], *of)) or of[1])
    told = []
    search = Search(ANYTHING, ANYTHING, [(what, np.ones((1, 2)))], np.zeros((1, 0)), 160, 0, ANYTHING, told.append)
    stage, found = search.run()
    other = not accepted and gap > 1.5 and (stands or what is FAST)
    assert swapped == ([False, True] if other else [False] * len(used))
    assert used == ([MOST, EVERY] if again else [MOST] * len(swapped))
    # the noise of the sensors is not found twice
    assert knew == ([None, NEAR.misjudged] if again or other else [None])
    assert stage == "stage"
    # joints that touch nothing are asked last, and once
    assert alone == ([] if accepted or gap < LEAST_GAP else [(MOST if other else used[-1], stage, found)])
    assert len(told) == (again or other)
    assert found.selection.steps == (3 if again or other else 1)  # what both simulated counts


@pytest.mark.parametrize("other", [[], ["found"]])
def test_the_other_half_is_asked_where_this_one_found_nothing(other, monkeypatch):
    """Where that one finds nothing either, all stays as it was; its steps count."""
    made = {}

    def to_the_end(search: Search) -> tuple[Any, Any]:
        selection = Leaving(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2), steps=5)
        selection.left, selection.stands = 9.0, True
        accepted = other if search.swapped else []
        made[search.swapped] = Found(ANYTHING, NEAR, selection, ANYTHING, accepted, early=search.swapped)
        return f"stage {search.swapped}", made[search.swapped]

    monkeypatch.setattr(Search, "_to_the_end", to_the_end)
    monkeypatch.setattr(Search, "_by_free_joints", lambda search, *of: of[1])
    search = Search(
        ANYTHING, ANYTHING, [(FAST, np.ones((1, 1)))], np.zeros((1, 0)), 160, 0, ANYTHING, lambda what: None
    )
    assert search.run() == (f"stage {bool(other)}", made[bool(other)])
    assert made[bool(other)].selection.steps == 10


def test_joints_are_not_asked_by_themselves_where_all_were_asked_over_the_same_windows(monkeypatch):
    """Where recordings are too short for shorter windows."""
    selection = Leaving(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2))
    found = Found(ANYTHING, NEAR, selection, ANYTHING, [], early=False)
    monkeypatch.setattr(Search, "_to_the_end", lambda search: (NEAR, found))
    search = Search(ANYTHING, ANYTHING, [(FAST, np.ones((1, 1)))], np.zeros((1, 0)), 160, 0, ANYTHING, ANYTHING)
    assert search.run() == (NEAR, found)


def test_more_windows_are_more_of_the_same():
    """All that the longest windows hold, in order; the fewer are among them."""
    recordings = cut_recordings(pushes(0.5, rows=400), 0, 0, 160)
    for most in (MOST, EVERY):
        shortest = brief(recordings, most)[0]
        assert single_steps(recordings, most) == len(shortest.fit) + len(shortest.held)
    assert single_steps(replace(recordings, horizons=recordings.horizons[-1:])) == 0
    # a single step from a velocity that nobody measured is left out
    alone = replace(recordings, encoders=replace(recordings.encoders, computed=np.tile((-0.5, 0.0, 0.5), (2, 1))))
    for most in (MOST, EVERY):
        shortest = brief(alone, most)[0]
        assert single_steps(alone, most) == len(shortest.fit) + len(shortest.held)
    assert brief(replace(alone, horizons=alone.horizons[:2])) == []
    assert single_steps(replace(alone, horizons=alone.horizons[:2])) == 0
    for some, every in zip(brief(recordings), brief(recordings, EVERY), strict=True):
        steps = some.horizons[-1]
        assert every.horizons == some.horizons
        assert len(every.fit) == min(round(EVERY / steps**0.5), len(recordings.fit) * (recordings.fit.horizon // steps))
        where = {(e, r) for e, r in zip(every.fit.episode, every.fit.row, strict=True)}
        assert {(e, r) for e, r in zip(some.fit.episode, some.fit.row, strict=True)} <= where
        assert len(where) == len(every.fit)
    assert len(brief(recordings)[0].fit) < len(brief(recordings, EVERY)[0].fit)


@pytest.mark.parametrize(("touches", "untouched"), [(True, False), (True, True), (False, False)])
def test_beside_contacts_next_to_nothing_is_not_searched(touches, untouched):
    """A tenth of the noise that was believed; a little more is, and so is smooth motion, where a test finds it."""
    sigma = np.ones(2) if touches else None
    chosen = Leaving(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=sigma, last=True, untouched=untouched)
    for left, nothing in ((0.9 * LEAST_GAP, touches), (1.1 * LEAST_GAP, False)):
        chosen.left = left
        assert chosen._nothing_left(ANYTHING, []) is nothing


@pytest.mark.parametrize("kept", [None, "halves of the earlier search"])
def test_what_was_asked_of_some_halves_is_not_asked_of_others(kept, monkeypatch):
    """A search for the first time chooses halves that show the gap alike; a second one has those of the first."""
    recordings = cut_recordings(pushes(0.5, rows=120), 0, 0, 40)
    part = "nfpde.gap.search."
    monkeypatch.setattr(part + "first_fit", lambda *args, **options: ("base", "court"))
    monkeypatch.setattr(part + "moved_over", lambda *args: ("base", "court"))
    monkeypatch.setattr(part + "gaps", lambda base, court: np.ones(80))
    monkeypatch.setattr(part + "alike_halves", lambda *args: "halves alike")
    stage = SimpleNamespace(court=ANYTHING, yardstick=ANYTHING, base="base", sigma=np.ones(2))
    monkeypatch.setattr(part + "in_noise", lambda *args, share, **options: knew.append(share) or stage)
    knew, cuts = [], []

    class Choosing(Search):
        def cut(self, lead=None, held=None):
            cuts.append(held)
            return recordings

        def _select(self, near, selection, earlier=None, *, further=False) -> Any:
            return near, selection, "base", []

    chosen = Leaving(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING)
    data: Any = SimpleNamespace(control_dt=0.01)
    search = Choosing(ANYTHING, data, [], np.zeros((1, 0)), 40, 0, lambda stage: chosen, lambda what: None)
    assert search._run(early=False).halves == "halves alike"
    assert cuts[-1] == "halves alike"
    before: Any = SimpleNamespace(halves=kept, early=False, misjudged=NEAR.misjudged, xi=np.zeros(0), level=0.0)
    cuts.clear()
    assert replace(search, before=before)._run(early=False).halves == kept
    assert {held for held in cuts if held} == ({kept} if kept else set())
    assert knew == [None, NEAR.misjudged]


def test_what_was_tried_first_is_shown_in_the_noise_of_the_end(monkeypatch):
    """In smooth motion, where less noise than was believed lets more effects be asked for."""
    recordings = cut_recordings(pushes(0.5, rows=120), 0, 0, 40)
    part = "nfpde.gap.search."
    monkeypatch.setattr(part + "moved_over", lambda *args: ("base", "court"))
    monkeypatch.setattr(part + "best_beginning", lambda selection, base, final, accepted: (final, accepted))
    stages = []

    def in_noise(*args: Any, **options: Any) -> Any:
        number = len(stages)
        stages.append(
            SimpleNamespace(
                court=ANYTHING,
                yardstick=ANYTHING,
                base=SimpleNamespace(),
                misjudged=1.0,
                recordings=recordings,
                shown=lambda trial, refitted: (trial[0], f"noise {number}"),
            )
        )
        return stages[-1]

    monkeypatch.setattr(part + "in_noise", in_noise)
    found: Any = [SimpleNamespace(effect=FAST)]
    tried: Any = [("one", "noise 0"), ("other", "noise 0")]

    class Quieter(Search):
        def _begun(self, *, early) -> Any:
            return None, recordings, "base", "court"

        def _may_hide(self, near, selection, final):
            return near is stages[0]

        def _hid(self, anew, selection, final):
            return True

        def _select(self, near, selection, earlier=None, *, further=False) -> Any:
            if not further:
                selection.ranking[:] = tried
            return near, selection, SimpleNamespace(fit=ANYTHING), found * (1 + further)

    chosen = Leaving(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING)
    data: Any = SimpleNamespace(control_dt=0.01)
    told = Quieter(ANYTHING, data, [], np.zeros((1, 0)), 40, 0, lambda stage: chosen, lambda what: None)._run(
        early=False
    )
    assert len(stages) == 2
    assert told.near is stages[1]
    assert told.selection.ranking == [("one", "noise 1"), ("other", "noise 1")]
