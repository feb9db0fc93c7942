"""How episodes begin: what was found without their first rows must hold there, too."""

from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.begins import begins_otherwise
from nfpde.gap.brief import brief
from nfpde.gap.found import Found
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.search import Search
from tests.test_gap_contacts import BLOCK, pushes

ANYTHING = cast("Any", None)


def final(*effects, values=()) -> Any:
    """A trial with effects at values."""
    replay = Replay(mujoco.MjModel.from_xml_string(BLOCK), None, effects, 1)
    return SimpleNamespace(fit=SimpleNamespace(replay=replay, xi=np.array(values, dtype=float)))


def test_a_fall_tells_what_rest_does_not():
    """A block let go a centimetre above its floor: what brakes its fall does nothing once it rests."""
    data = pushes(0.5, height=-0.01, noise=1e-6)
    every = brief(cut_recordings(data, 0, 0, 160))[0]
    sigma = np.array([1e-6, 1e-6, 1e-5, 1e-5])
    height, damping = effect("ground_height", height=(-0.1, 0.1)), effect("viscous_damping", "up", damping=(0, 20))
    truth, alike = final(height, values=[-0.01]), final(height, damping, values=[-0.01, 2.0])
    assert not begins_otherwise(truth, sigma, every, 20, 0.02, 0)
    assert begins_otherwise(alike, sigma, every, 20, 0.02, 0)
    assert not begins_otherwise(alike, sigma, every, 0, 0.02, 0)  # none were left out
    assert not begins_otherwise(alike, sigma, every, 10**6, 0.02, 0)  # there are no others
    # what noise leaves there is no contradiction: where it is a thousand times as loud, nothing is
    assert not begins_otherwise(alike, 1e3 * sigma, every, 20, 0.02, 0)


class Beginning(Search):
    """A search that finds a worn motor without beginnings, and with them what it is told to."""

    steps = 7

    def _run(self, *, early):
        self.report({None: "as ever", True: "with", False: "without"}[early])
        name = "motor_strength" if not early else self.candidates[0][0].name
        accepted: Any = [SimpleNamespace(effect=SimpleNamespace(name=name, memory_time=lambda: float(name == "late")))]
        near: Any = SimpleNamespace(recordings=ANYTHING)
        selection: Any = SimpleNamespace(steps=self.steps, sigma=np.zeros(1))
        return Found(ANYTHING, near, selection, ANYTHING, accepted, early is True)

    def _begin_otherwise(self, found):
        return True


@pytest.mark.parametrize(("there", "named"), [("ground_height", "ground_height"), ("late", "motor_strength")])
def test_what_beginnings_contradict_is_searched_with_them(there, named):
    """What they tell counts, but an effect of earlier commands, which nobody recorded; the steps of both add up."""
    said: list[str] = []
    candidate: Any = SimpleNamespace(name=there, whole=None)
    search = Beginning(ANYTHING, ANYTHING, [(candidate, ANYTHING)], np.zeros((1, 0)), 8, 0, ANYTHING, said.append)
    found = search._with_beginnings()
    assert said == ["as ever", "how episodes begin", "with"]
    assert [a.effect.name for a in found.accepted] == [named]
    assert found.selection.steps == 2 * Beginning.steps


@pytest.mark.parametrize("why", ["touches nothing", "nothing found", "looked at", "acts late"])
def test_beginnings_are_not_always_asked(why):
    """Only where contacts are, and something was found without them that does not act by earlier commands."""
    candidate: Any = SimpleNamespace(whole=None if why == "touches nothing" else "contact")
    search = Search(ANYTHING, ANYTHING, [(candidate, ANYTHING)], ANYTHING, 8, 0, ANYTHING, lambda what: None)
    accepted: Any = [SimpleNamespace(effect=SimpleNamespace(memory_time=lambda: float(why == "acts late")))]
    accepted = [] if why == "nothing found" else accepted
    assert not search._begin_otherwise(
        Found(ANYTHING, ANYTHING, ANYTHING, ANYTHING, accepted, early=why == "looked at")
    )
