"""Joints that touch nothing, beside contacts: asked about over the longest windows, where they stand out."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.gap.acceptance import LEAST_GAP
from nfpde.gap.found import Found
from nfpde.gap.levels import NEAR_FLOOR, Yardstick
from nfpde.gap.outcome import Outcome
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.rounds import Rounds
from nfpde.gap.search import Search
from nfpde.gap.select import Selection
from nfpde.gap.trial import Court, Trial
from tests.gap_systems import nominal, record

ANYTHING: Any = None

BLOCK = np.arange(60) // 3


def selection(noise: np.ndarray) -> Selection:
    """A selection beside noise (draws, N, 2, C)."""
    court = Court(BLOCK, ANYTHING, ANYTHING, np.zeros(noise.shape[2:]), np.zeros(0), ANYTHING)
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
    ("touches", "accepted", "chance", "expected"),
    [(True, (), False, 4.0), (True, (), True, NEAR_FLOOR), (True, ("effect",), False, 1.0), (False, (), False, 1.0)],
)
def test_a_joint_that_stands_out_and_is_not_explained_is_a_gap(touches, accepted, chance, expected):
    """Three joints leave next to nothing and a fourth leaves four floors: one in the mean.

    Where noise has one stand out as far, there is no gap.
    """
    rng = np.random.default_rng(10)
    noise, factors = rng.normal(size=(3, 60, 4, 8)), np.array([0.05, 0.05, 0.05, 2.0])[:, None]
    chosen: Any = selection(noise)
    chosen.sigma = np.ones(8) if touches else None
    chosen._floors = lambda trial: [chosen.yardstick.floor]
    chosen.by_chance = lambda trial, least: chance
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
    assert [e for e, _ in beside._open([])] == [soft, rub]
    assert [e for e, _ in there._open([])] == [rub]
    assert there._open([rub]) == []
    assert there._open([], {("coulomb_friction", "swing")}) == []
    assert (beside._touches, there._touches) == (True, False)


class Standing(Selection):
    """A selection that finds `more` effects beside what it is given, as long as a joint stands out."""

    out, more, chance = 2.0, 1, False

    def beyond(self, trial: Any) -> float:
        return self.out

    def by_chance(self, trial: Any, least: float) -> bool:
        assert least == self.out
        return self.chance

    def useful(self, base, trial, accepted):
        return trial, accepted

    def gap_of(self, trial: Any):
        return 3.0

    def refitted(self, current, taken) -> Any:
        self.steps += 10
        return [f"effect {len(taken) + 1}"] if len(taken) < 1 + self.more else []

    def accept(self, current, trials: Any, first_gap, level=0.0, settled=None) -> Any:
        return (SimpleNamespace(fit=None), SimpleNamespace(effect=trials[0])) if trials else None

    def _idle(self, trial, current, first_gap):
        return None

    def _asks_for_twins(self, found):
        return False

    def _converged(self, fit: Any) -> Any:
        return "with more"

    def linear(self, trial, *, fitted):
        return trial

    def _pruned(self, current, accepted, first_gap, carried=()):
        return current, accepted

    def _carried(self, base, trial, accepted, first_gap):
        raise AssertionError("what contacts do is asked of short windows")

    def _second_look(self, current, accepted, first_gap):
        raise AssertionError("what contacts do is asked of short windows")


class Longest(Search):
    """A search whose stage of the longest windows is given."""

    def after(self, before: Any, longer, known, *, look=True, dofs=None) -> Any:
        assert not look
        if dofs is None:
            return LONG
        assert before is LONG  # it knows the noise of the sensors
        assert dofs.tolist() == [0, 1]
        return PART


def stage_of(name: str) -> Any:
    """A stage whose base does not stand out, and which shows trials as its own."""
    return SimpleNamespace(
        court=name,
        yardstick=None,
        base=SimpleNamespace(fit=None),
        shown=lambda t, refitted: (name, t, refitted),
        sigma=np.ones(2),
    )


LONG, PART = stage_of("all joints"), stage_of("joints that touch nothing")


@pytest.mark.parametrize(
    ("out", "more", "chance", "named"), [(2.0, 1, False, 2), (2.0, 0, False, 1), (1.4, 1, False, 1), (2.0, 1, True, 1)]
)
def test_longest_windows_are_searched_where_a_joint_stands_out(out, more, chance, named, monkeypatch):
    """What was found on short windows stands there as it was, and one more is named; else all stays as it was."""
    monkeypatch.setattr(Standing, "out", out)
    monkeypatch.setattr(Standing, "more", more)
    monkeypatch.setattr(Standing, "chance", chance)
    asks = out > NEAR_FLOOR and not chance
    monkeypatch.setattr("nfpde.gap.search.asks_again", lambda *told: False)
    said: list[str] = []
    chosen = Standing(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2), steps=5)
    search = Longest(ANYTHING, ANYTHING, [], np.zeros((1, 0)), 8, 0, ANYTHING, said.append)
    short: Any = SimpleNamespace()
    first: Any = SimpleNamespace(effect="effect 1", rivals=(), close=())
    final: Any = SimpleNamespace(fit=None)
    stage, found = search.over_longest(Found(ANYTHING, short, chosen, final, [first], early=False))
    assert stage is LONG
    assert found.accepted[0] is first
    assert len(found.accepted) == named
    assert (found.near is LONG) is (named == 2)
    assert (found.final == ("all joints", final, True)) is (named == 1)
    assert bool(said) is asks
    # refits were counted, whether anything came of them or not
    assert found.selection.steps == {2: 25, 1: 15 if asks else 5}[named]


@pytest.mark.parametrize(("out", "chance", "named"), [(1.4, False, 1), (2.0, False, 2), (2.0, True, 1)])
def test_such_joints_are_asked_for_a_first_effect_though_none_stands_out(out, chance, named, monkeypatch):
    """What they leave after that, only where one does."""
    monkeypatch.setattr(Standing, "out", out)
    monkeypatch.setattr(Standing, "chance", chance)
    chosen = Standing(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2), untouched=True)
    base: Any = SimpleNamespace(fit=None)
    _, accepted = chosen.run(base)
    assert [a.effect for a in accepted] == ["effect 1", "effect 2"][:named]


class Beside(Standing):
    """Finds an effect where joints that touch nothing are asked by themselves, and nowhere else."""

    out, keeps = 1.4, True

    def run(self, base, earlier=None, *, further=False) -> Any:
        self.steps += 10
        assert self.court == "joints that touch nothing"
        assert self.untouched
        assert self.last
        assert earlier is None
        self.ranking.append("tried")  # type: ignore[arg-type]
        return ("found", ["effect"]) if self.more else (base, [])

    def useful(self, base, trial, accepted):
        return (trial, accepted) if self.keeps else (base, [])


@pytest.mark.parametrize(("more", "keeps"), [(1, True), (0, True), (1, False)])
def test_joints_that_touch_nothing_are_asked_by_themselves_where_nothing_was_found(more, keeps, monkeypatch):
    """What they ask for stands over all joints, if it makes nothing worse there; their windows know its values."""
    monkeypatch.setattr(Beside, "more", more)
    monkeypatch.setattr(Beside, "keeps", keeps)
    said: list[str] = []
    chosen = Beside(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2), steps=5)
    start: Any = SimpleNamespace(sim=SimpleNamespace(model=nominal()))
    search = Longest(start, ANYTHING, [], np.zeros((1, 0)), 8, 0, ANYTHING, said.append)
    cut = cut_recordings(record(), 0, 0, 40)
    stage, found = search.over_longest(Found(cut, PART, chosen, ANYTHING, [], early=False))
    assert stage is LONG
    assert (found.accepted, said) == ([], [])
    found = search._by_free_joints(stage, found)
    assert said == ["joints that touch nothing"]
    assert found.selection.steps == 15
    assert found.selection.court == "all joints"
    if more and keeps:
        assert found.accepted == ["effect"]
        assert found.final == ("all joints", "found", True)
        assert (found.near, found.by) == (LONG, PART)
        assert found.selection.ranking == [("all joints", "tried", False)]
    else:
        assert (found.accepted, found.final, found.near, found.by) == ([], LONG.base, PART, None)
        assert found.selection.ranking == []


def test_such_joints_are_asked_where_something_is_left(monkeypatch):
    monkeypatch.setattr(Beside, "gap_of", lambda selection, trial: 0.9 * LEAST_GAP)
    chosen = Beside(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2), steps=5)
    start: Any = SimpleNamespace(sim=SimpleNamespace(model=nominal()))
    search = Longest(start, ANYTHING, [], np.zeros((1, 0)), 8, 0, ANYTHING, lambda what: None)
    cut = cut_recordings(record(), 0, 0, 40)
    found = search._by_free_joints(LONG, Found(cut, PART, chosen, ANYTHING, [], early=False))
    assert (found.accepted, found.by, found.selection.steps) == ([], None, 5)


def test_a_joint_that_touches_something_is_not_asked_by_itself():
    """A block on the floor has none that does not."""
    block = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom type='plane' size='1 1 .1'/><body pos='0 0 .05'><freejoint/>"
        "<geom type='box' size='.05 .05 .05'/></body></worldbody></mujoco>"
    )
    time = 0.01 * np.arange(400)
    rest = Episode("rest", time, np.tile(block.qpos0, (400, 1)), np.zeros((400, 6)), np.zeros((400, 0)))
    chosen = Beside(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(2), steps=5)
    start: Any = SimpleNamespace(sim=SimpleNamespace(model=block))
    search = Longest(start, ANYTHING, [], np.zeros((1, 0)), 8, 0, ANYTHING, lambda what: None)
    cut = cut_recordings(Dataset([rest, replace(rest, name="again")]), 0, 0, 40)
    found = search._by_free_joints(LONG, Found(cut, PART, chosen, ANYTHING, [], early=False))
    assert (found.accepted, found.by, found.selection.steps) == ([], None, 5)


def test_its_own_windows_tell_how_well_values_are_known(monkeypatch):
    """Where joints that touch nothing told what was found, the others' jumps say nothing of it."""
    monkeypatch.setattr("nfpde.gap.outcome.standard_errors", lambda court, fit: (court, fit))

    def stage(name: str) -> Any:
        fitter = SimpleNamespace(resolved=lambda fit: f"slopes of {fit}")
        shown = lambda t, refitted: SimpleNamespace(fit=f"{t} on {name}")  # noqa: E731
        return SimpleNamespace(court=SimpleNamespace(name=name, fitter=fitter), shown=shown)

    whole, part = stage("all"), stage("part")
    final: Any = SimpleNamespace(fit="final")

    def outcome(by) -> Any:
        return Outcome(ANYTHING, whole, whole, final, (), ANYTHING, ANYTHING, ANYTHING, 0, "", ANYTHING, by)

    assert outcome(None).errors == (whole.court, "slopes of final")
    court, fit = outcome(part).errors
    assert court is part.court
    assert fit == f"slopes of {final} on part"
