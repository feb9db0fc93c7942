"""How sure each look at the same recordings must be: all together one level, also where none finds anything."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap import search as module
from nfpde.gap.search import Search
from nfpde.gap.select import Selection
from nfpde.gap.trial import LEVEL

ANYTHING: Any = None
FLOOR = effect("ground_height", height=(-0.01, 0.01))


class Stage(SimpleNamespace):
    """A stage on which nothing changes."""

    def shown(self, trial, *, refitted):
        """The same."""
        return trial


@pytest.mark.parametrize("at_floor", [True, False])
def test_looks_that_find_nothing_share_one_level(at_floor, monkeypatch):
    """Short windows, longer ones, joints that stand out, joints by themselves; and all of it once more.

    That is over more windows at the floor of noise, and with halves that have changed places above it.
    """
    base: Any = SimpleNamespace(fit=SimpleNamespace(xi=np.zeros(0), replay=ANYTHING))
    levels = []

    class Nothing(Selection):
        """A selection that finds nothing."""

        def run(self, base, earlier=None, *, further=False):
            """Look once."""
            levels.append(self.level)
            return base, []

        def spotless(self, trial):
            return False

        def at_floor(self, trial):
            return at_floor

        def stands_out(self, trial):
            return True

        def useful(self, base, trial, accepted):
            return base, accepted

    def stage(recordings):
        return Stage(recordings=recordings, base=base, court=court, yardstick=ANYTHING, sigma=np.ones(2), misjudged=1.0)

    court: Any = SimpleNamespace(capped=0.02)
    states = SimpleNamespace(state=np.zeros((1, 1, 2)))
    longest: Any = SimpleNamespace(fit=states, held=states, positions_alone=False)
    short = [SimpleNamespace(fit=states, held=states, positions_alone=False) for _ in range(3)]
    monkeypatch.setattr(module, "brief", lambda recordings, most=0: short)
    monkeypatch.setattr(module, "single_steps", lambda recordings, most: most)
    monkeypatch.setattr(module, "in_noise", lambda base, court, recordings, *_, **__: stage(recordings))
    monkeypatch.setattr(module, "joined", lambda fit, held: states)
    monkeypatch.setattr(module, "free_dofs", lambda model, states: np.array([0]))
    monkeypatch.setattr(module, "Far", lambda *_: ANYTHING)
    monkeypatch.setattr(Search, "_begun", lambda search, *, early: (None, longest, base, court))
    monkeypatch.setattr(Search, "_begin_otherwise", lambda *_: False)
    monkeypatch.setattr(Search, "_in_noise", lambda *_: False)
    monkeypatch.setattr(Search, "after", lambda search, before, longer, known, **_: stage(longer))

    def select(stage):
        return Nothing(court, ANYTHING, 1, ANYTHING, [], yardstick=ANYTHING)

    start: Any = SimpleNamespace(sim=SimpleNamespace(model=ANYTHING))
    search = Search(start, ANYTHING, [(FLOOR, np.zeros((1, 1)))], np.zeros((1, 0)), 60, 0, select, lambda words: None)
    search.run()
    assert len(levels) == 9
    assert sum(levels) <= LEVEL
    assert replace(search).touches
