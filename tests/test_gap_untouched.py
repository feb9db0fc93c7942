"""Joints that touch nothing, beside contacts: asked about over the longest windows, where they stand out."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.answer import Outcome
from nfpde.gap.levels import NEAR_FLOOR, Yardstick
from nfpde.gap.rounds import Rounds
from nfpde.gap.search import Found, Search
from nfpde.gap.select import Selection
from nfpde.gap.trial import Court, Trial

ANYTHING: Any = None

BLOCK = np.arange(60) // 3


def selection(noise: np.ndarray) -> Selection:
    """A selection beside noise (draws, N, 2, C)."""
    court = Court(BLOCK, ANYTHING, ANYTHING, np.zeros(noise.shape[2:]), np.zeros(0))
    return Selection(ANYTHING, None, 1, court, [], yardstick=Yardstick(np.ones(noise.shape[2:]), noise, 0.0))


def test_a_joint_stands_out_whatever_the_others_leave():
    """At one of two joints residuals are twice as large as noise is: four floors, which the mean of both halves."""
    rng = np.random.default_rng(8)
    noise, own = rng.normal(size=(3, 60, 2, 4)), rng.normal(size=(60, 2, 4))
    chosen = selection(noise)
    quiet = Trial(None, ANYTHING, np.zeros(60), own, np.zeros(60))
    loud = Trial(None, ANYTHING, np.zeros(60), own * np.array([0.5, 2.0])[:, None], np.zeros(60))
    # squares of 240 channels scatter by 9 % about their mean
    assert chosen.beyond(quiet) == pytest.approx(1.0, abs=4 * 0.09)
    assert chosen.beyond(loud) == pytest.approx(4.0, rel=4 * 0.09)
    assert chosen.stands_out(loud)
    assert not chosen.stands_out(quiet)
    assert chosen.yardstick.gap(loud.held).mean() == pytest.approx((0.25 + 4.0) / 2, rel=4 * 0.09)


def test_noise_alone_seldom_stands_out():
    """The lower end of what noise leaves is below one and a half floors, tails and jumps included."""
    rng = np.random.default_rng(9)
    for _ in range(20):
        noise, own = rng.standard_t(3, size=(3, 60, 2, 4)), rng.standard_t(3, size=(60, 2, 4))
        assert selection(noise).beyond(Trial(None, ANYTHING, np.zeros(60), own, np.zeros(60))) < NEAR_FLOOR


@pytest.mark.parametrize(
    ("touches", "accepted", "expected"),
    [(True, (), 4.0), (True, ("effect",), 1.0), (False, (), 1.0)],
)
def test_a_joint_that_stands_out_and_is_not_explained_is_a_gap(touches, accepted, expected):
    """Three joints leave next to nothing and a fourth leaves four floors: one in the mean."""
    rng = np.random.default_rng(10)
    noise, factors = rng.normal(size=(3, 60, 4, 8)), np.array([0.05, 0.05, 0.05, 2.0])[:, None]
    chosen: Any = selection(noise)
    chosen.sigma = np.ones(8) if touches else None
    chosen._floors = lambda trial: [chosen.yardstick.floor]
    left = rng.normal(size=(60, 4, 8)) * factors
    fit: Any = SimpleNamespace(residuals=left)
    final = Trial(None, fit, np.zeros(60), left, np.zeros(60))
    stage: Any = SimpleNamespace(yardstick=chosen.yardstick, recordings=SimpleNamespace(block=BLOCK))
    outcome = Outcome(ANYTHING, stage, stage, final, accepted, chosen, ANYTHING, ANYTHING, 0, "", ANYTHING)
    # a sum of 480 squares scatters by 6.5 %, and its interval's lower end lies two of these below
    assert outcome.least_over_floor() == pytest.approx(expected, rel=6 * 0.065)
    assert (outcome.least_over_floor() > NEAR_FLOOR) is (expected > NEAR_FLOOR)


def test_what_contacts_do_is_no_candidate_there():
    """Nor is it searched for as it is where contacts decide."""
    soft = effect("contact_softness", time_constant=(0.001, 0.1), damping_ratio=(0.1, 2.0))
    rub = effect("coulomb_friction", "swing", torque=(0.0, 1.0))
    candidates = [(soft, np.ones((1, 2))), (rub, np.ones((1, 1)))]
    court: Any = SimpleNamespace(capped=0.02)
    beside, there = (Rounds(ANYTHING, None, 1, court, candidates, untouched=u) for u in (False, True))
    assert [e for e, _ in beside._open(set())] == [soft, rub]
    assert [e for e, _ in there._open(set())] == [rub]
    assert there._open({("coulomb_friction", "swing")}) == []
    assert (beside._touches, there._touches) == (True, False)


class Standing(Selection):
    """A selection that finds `more` effects beside what it is given, as long as a joint stands out."""

    out, more = 2.0, 1

    def beyond(self, trial: Any) -> float:
        return self.out

    def useful(self, base, trial, accepted):
        return trial, accepted

    def gap_of(self, trial: Any):
        return 3.0

    def refitted(self, current, taken) -> Any:
        self.steps += 10
        return [f"effect {len(taken) + 1}"] if len(taken) < 1 + self.more else []

    def accept(self, current, trials: Any, first_gap) -> Any:
        return (SimpleNamespace(fit=None), SimpleNamespace(effect=trials[0])) if trials else None

    def _idle(self, trial, current, first_gap):
        return None

    def _asks_for_twins(self, found):
        return False

    def _converged(self, fit: Any) -> Any:
        return "with more"

    def _linear(self, trial, *, fitted):
        return trial

    def _pruned(self, current, accepted, first_gap, carried=()):
        return current, accepted

    def _carried(self, base, trial, accepted, first_gap):
        raise AssertionError("what contacts do is asked of short windows")

    def _second_look(self, current, accepted, first_gap):
        raise AssertionError("what contacts do is asked of short windows")


class Longest(Search):
    """A search whose stage of the longest windows is given."""

    def after(self, before: Any, longer, known, *, look=True) -> Any:
        assert not look
        return LONG


LONG: Any = SimpleNamespace(
    court=None, yardstick=None, base=SimpleNamespace(fit=None), shown=lambda t, refitted: t, sigma=np.ones(2)
)


@pytest.mark.parametrize(("out", "more", "named"), [(2.0, 1, 2), (2.0, 0, 1), (1.4, 1, 1)])
def test_longest_windows_are_searched_where_a_joint_stands_out(out, more, named, monkeypatch):
    """What was found on short windows stands there as it was, and one more is named; else all stays as it was."""
    monkeypatch.setattr(Standing, "out", out)
    monkeypatch.setattr(Standing, "more", more)
    said: list[str] = []
    chosen = Standing(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2), steps=5)
    search = Longest(ANYTHING, ANYTHING, [], np.zeros((1, 0)), 8, 0, ANYTHING, said.append)
    short: Any = SimpleNamespace()
    first: Any = SimpleNamespace(effect="effect 1")
    final: Any = SimpleNamespace(fit=None)
    stage, found = search.over_longest(Found(ANYTHING, short, chosen, final, [first], early=False))
    assert stage is LONG
    assert found.accepted[0] is first
    assert len(found.accepted) == named
    assert (found.near is LONG) is (named == 2)
    assert (found.final is final) is (named == 1)
    assert bool(said) is (out > NEAR_FLOOR)
    # refits were counted, whether anything came of them or not
    assert found.selection.steps == {2: 25, 1: 15 if out > NEAR_FLOOR else 5}[named]
