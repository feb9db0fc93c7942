"""How episodes begin: what was found without their first rows must hold there, too."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.begins import begins_otherwise
from nfpde.gap.brief import brief
from nfpde.gap.found import Found
from nfpde.gap.recordings import cut_recordings, joined
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


@pytest.mark.parametrize("chance", [False, True])
def test_what_noise_does_there_now_and_then_contradicts_nothing(chance, monkeypatch):
    """Falls are few and loud: what is shown there, far beyond noise on average, is held against single draws of it."""
    every = brief(cut_recordings(pushes(0.5, height=-0.01, noise=1e-6), 0, 0, 160))[0]
    sigma = np.array([1e-6, 1e-6, 1e-5, 1e-5])
    height, damping = effect("ground_height", height=(-0.1, 0.1)), effect("viscous_damping", "up", damping=(0, 20))
    alike, asked = final(height, damping, values=[-0.01, 2.0]), list[float]()

    def by_chance(fit, sigma, there, excess, least):
        assert (there.windows.row < 20).all()
        assert least == excess(there.residuals_at(fit.replay, fit.xi[None])[0])
        asked.append(least)
        return chance

    monkeypatch.setattr("nfpde.gap.begins.by_chance", by_chance)
    assert begins_otherwise(alike, sigma, every, 20, 0.02, 0) is not chance
    assert not begins_otherwise(alike, 1e3 * sigma, every, 20, 0.02, 0)
    assert len(asked) == 1, "what noise does on average needs no such look"


@pytest.mark.parametrize(("row", "otherwise"), [(0, False), (6, True), (40, False)])
def test_the_first_row_says_nothing_of_what_was_found(row, otherwise):
    """Robots are put down so that they just touch, and noise decides whether they do; later rows are the model's work.

    Here one row's speed is wrong: what is simulated from there is, too. Where it is no beginning, nothing is.
    """
    data = pushes(0.5, noise=1e-6)
    episodes = [replace(e, qvel=e.qvel + 0.1 * (np.arange(len(e)) == row)[:, None]) for e in data]
    every = brief(cut_recordings(replace(data, episodes=episodes), 0, 0, 160))[0]
    sigma = np.array([1e-6, 1e-6, 1e-5, 1e-5])
    truth = final(effect("ground_height", height=(-0.1, 0.1)), values=[0.0])
    assert (joined(every.fit, every.held).row == row).any()
    assert begins_otherwise(truth, sigma, every, 20, 0.02, 0) is otherwise


class Beginning(Search):
    """A search that finds one effect without beginnings, and with them another."""

    otherwise: bool

    def _run(self, *, early):
        self.report("with" if early else "without")
        effect, _ = self.candidates[early]
        near: Any = SimpleNamespace(recordings=ANYTHING)
        accepted: Any = [SimpleNamespace(effect=effect)]
        selection: Any = SimpleNamespace(steps=7, sigma=np.zeros(1))
        return Found(ANYTHING, near, selection, ANYTHING, accepted, early)

    def _begin_otherwise(self, found):
        return self.otherwise


WORN, LATE = (
    effect("motor_strength", "along", scale=(0.0, 2.0)),
    effect("actuation_delay", "along", delay=(0.0, 0.1)),
)


@pytest.mark.parametrize(
    ("there", "otherwise", "runs"),
    [
        ([WORN, WORN], False, ["without"]),
        ([WORN, WORN], True, ["without", "with"]),
        ([LATE, WORN], True, ["without"]),  # nobody knows what was commanded before, and beginnings differ for that
        ([WORN, LATE], True, ["without", "with"]),
    ],
)
def test_what_beginnings_contradict_is_searched_with_them(there, otherwise, runs):
    """What they tell counts, but an effect of earlier commands, which nobody recorded; the steps of both add up."""
    said: list[str] = []
    search = Beginning(ANYTHING, ANYTHING, [(e, ANYTHING) for e in there], ANYTHING, 8, 0, ANYTHING, said.append)
    Beginning.otherwise = otherwise
    found = search._with_beginnings()
    assert [s for s in said if s != "how episodes begin"] == runs
    assert found.early is (len(runs) == 2 and there[1] is not LATE)
    assert found.selection.steps == 7 * len(runs)
