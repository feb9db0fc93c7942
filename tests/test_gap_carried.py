"""Accepted effects later on: told apart once, dropped where they do nothing or harm."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.accepted import Accepted, key
from nfpde.gap.fit import Fitter
from nfpde.gap.levels import Yardstick
from nfpde.gap.noise import learn_scatter
from nfpde.gap.search import Search
from nfpde.gap.select import Selection
from nfpde.gap.stage import Stage
from nfpde.gap.trial import Court, Trial

ANYTHING: Any = None

MEASURED = Yardstick(np.ones((1, 2)), np.zeros((1, 1, 1, 2)))


class Numbered(Selection):
    """A selection of numbered effects, each of which removes so much of a gap of ten, whatever else is there."""

    removes = (0.0,)

    def linear(self, trial: Any, *, fitted) -> Any:
        return SimpleNamespace(effects=trial.effects, linear=fitted)

    def without(self, trial: Any, index) -> Any:
        return SimpleNamespace(effects=[e for i, e in enumerate(trial.effects) if i != index])

    def gap_of(self, trial: Any):
        return 10.0 - sum(self.removes[e] for e in trial.effects)

    _usual_gap = gap_of


@pytest.mark.parametrize(
    ("removes", "kept"), [((5.0, -3.0, 2.0), [0, 2]), ((5.0, -0.01), [0, 1]), ((-1.0, -2.0), []), ((4.0,), [0])]
)
def test_effects_that_make_the_longest_windows_worse_are_dropped(removes, kept, monkeypatch):
    """What adds to the gap goes, down to the parameters alone; what hardly changes it stays."""
    monkeypatch.setattr(Numbered, "removes", removes)
    selection = Numbered(ANYTHING, None, 1, ANYTHING, [], yardstick=MEASURED)
    base: Any = SimpleNamespace(effects=[], linear=True)
    trial: Any = SimpleNamespace(effects=list(range(len(removes))), linear=True)
    accepted: Any = list(range(len(removes)))
    found: Any
    found, rest = selection.useful(base, trial, accepted)
    assert list(rest) == found.effects == kept
    assert found.linear  # standard errors are read off it


def test_effects_that_others_have_made_superfluous_are_dropped(monkeypatch):
    """Of three effects the one that removes nothing any more goes, the others stay in their order."""
    monkeypatch.setattr(Numbered, "removes", (5.0, 0.0, 3.0))
    selection = Numbered(ANYTHING, None, 1, ANYTHING, [], yardstick=MEASURED)
    everything: Any = SimpleNamespace(effects=[0, 1, 2])
    accepted: Any = [0, 1, 2]
    current: Any
    current, kept = selection._pruned(everything, accepted, 10.0)
    assert kept == current.effects == [0, 2]
    monkeypatch.setattr(Numbered, "removes", (0.0, 0.0, 0.0))
    assert len(selection._pruned(everything, accepted, 10.0)[1]) == 1  # what was asked for is not all given up


@pytest.mark.parametrize(("gained", "removed", "stays"), [(0.3, 0.1, True), (-0.3, 0.1, False), (0.3, -0.1, False)])
def test_what_shorter_windows_asked_for_stays_where_longer_ones_do_not_speak_against_it(gained, removed, stays):
    """What it is worth shows at one length and hardly at another; who asked for it was right unless it harms here."""

    class Dense(Numbered):
        removes = (5.0, removed)

        def without(self, trial: Any, index) -> Any:
            return SimpleNamespace(effects=super().without(trial, index).effects, density=np.zeros(40))

    court = Court(np.arange(40) // 4, ANYTHING, ANYTHING, np.zeros((1, 2)), np.zeros(0), ANYTHING)
    selection = Dense(ANYTHING, None, 1, court, [], yardstick=MEASURED)
    everything: Any = SimpleNamespace(effects=[0, 1], density=gained + 0.01 * np.random.default_rng(1).normal(size=40))
    accepted: Any = [0, 1]
    assert selection._pruned(everything, accepted, 10.0, accepted)[1] == ([0, 1] if stays else [0])
    assert selection._pruned(everything, accepted, 10.0)[1] == [0]


def test_an_effect_is_not_tried_beside_itself():
    """A rival that has been accepted since is no rival any more."""
    friction, damping = effect("coulomb_friction", "elbow", torque=(0, 1)), effect("armature", "elbow", inertia=(0, 1))
    residuals = np.zeros((4, 1, 2))

    def trial(which):
        return Trial(which, ANYTHING, np.zeros(4), residuals, np.zeros(4))

    accepted = [
        Accepted(friction, trial(friction), (trial(damping),), (), ()),
        Accepted(damping, trial(damping), (), (), ()),
    ]
    selection = Selection(ANYTHING, None, 1, ANYTHING, [], yardstick=MEASURED)
    current = trial(damping)
    assert selection._told_apart(current, accepted, 0, 1.0) == (current, accepted)


class Again(Selection):
    """A selection that notes which effects it refits, and accepts none."""

    refits: list[Any]
    stays: Any = None

    def without(self, trial, index):
        return trial

    def again(self, smaller, trials):
        self.refits = [t.effect for t in trials]
        return []

    def accept(self, current, trials, first_gap, level=0.0, settled=None):
        self.stays = settled


def test_what_left_nearly_as_little_on_shorter_windows_is_tried_again():
    """Equal or not: each once, and none that has been accepted since."""
    names = ("coulomb_friction", "armature", "viscous_damping", "joint_offset")
    keys = ("torque", "inertia", "damping", "offset")
    all_four = [effect(n, "elbow", **{k: (0, 1)}) for n, k in zip(names, keys, strict=True)]
    first, near, rival, other = (Trial(e, ANYTHING, np.zeros(4), ANYTHING, np.zeros(4)) for e in all_four)
    asked = Accepted(all_four[0], first, (rival,), (near, rival, other), ())
    beside = Accepted(all_four[3], other, (), (), ())
    selection = Again(ANYTHING, None, 1, ANYTHING, [], yardstick=MEASURED)
    assert selection._told_apart(other, [asked, beside], 0, 1.0) == (other, [asked, beside])
    assert selection.refits == [all_four[0], all_four[1], all_four[2]]
    assert selection.stays == key(all_four[0])


class Asking(Selection):
    """A selection of trials that say what gap they leave; no candidate is worth anything."""

    rounds = 0

    def gap_of(self, trial: Any):
        return trial.left

    def at_floor(self, trial: Any):
        return trial.left < 1.5

    def floor(self, trial: Any):
        return 1.0

    def given_by_noise(self, trial: Any, current: Any, sigma: Any, gain: Any):
        return False

    def refitted(self, current, taken):
        self.rounds += 1
        return []

    def _carried(self, base, trial, accepted, first_gap):
        return trial, accepted

    def linear(self, trial: Any, *, fitted) -> Any:
        return trial


def test_what_is_left_is_asked_about_once():
    """On longer windows only where nobody asked on the shorter ones, as nothing was left there but noise.

    On the last ones always; beside contacts, where the floor is known to a factor only, even below it.
    """
    selection = Asking(ANYTHING, None, 1, ANYTHING, [], yardstick=MEASURED, last=False)
    base: Any = SimpleNamespace(left=100.0)

    def run(left, **more):
        fit = SimpleNamespace(replay=SimpleNamespace(effects=("found",)))
        before: Any = SimpleNamespace(left=left, fit=fit), [SimpleNamespace(effect=None)]
        selection.run(base, before, **more)
        rounds, selection.rounds = selection.rounds, 0
        return rounds

    assert run(1.0) == 0  # noise: nothing to ask
    assert run(4.0) == 1
    assert run(4.0) == 0  # the same, on windows longer still
    assert run(4.0, further=True) == 1
    assert run(40.0) == 1  # much of the gap: asked again
    selection.last = True
    assert run(4.0) == 1
    assert run(1.0) == 0
    selection.sigma = np.ones(4)
    assert run(1.0) == 1


class Line:
    """A replay whose residuals are `start` and `slopes` times its parameters, the last of which is an effect's."""

    def __init__(self, start, slopes, effects):
        self.start, self.slopes, self.effects = start, np.array(slopes), effects
        self.nfree, self.low, self.high = len(slopes), np.zeros(len(slopes)), np.ones(len(slopes))
        self.sim = SimpleNamespace(simulated_steps=0)

    def columns(self, index):
        return slice(self.nfree - 1, self.nfree)

    def inward(self, xi):
        return xi

    def outward(self, u):
        return u

    def residuals(self, xi, windows, horizons, force=None):
        self.sim.simulated_steps += len(xi)
        return self.start + np.einsum("md,dnvc->mnvc", xi, self.slopes)


class Stuck(Selection):
    """A selection that knows its replay without the effect."""

    smaller: Any = None

    def replay(self, effects) -> Any:
        return self.smaller

    def _converged(self, fit) -> Any:
        return fit


@pytest.mark.parametrize(("size", "idle"), [(0.0, True), (1.0, False)])
def test_an_effect_is_not_credited_with_what_the_parameters_had_missed(size, idle, monkeypatch):
    """The parameter got where it should be beside an effect that does nothing; one that does something counts."""
    rng = np.random.default_rng(30)
    one, other = rng.normal(size=(2, 50, 1, 2))
    start = -0.3 * one - 0.7 * size * other + 1e-3 * rng.normal(size=one.shape)
    scatter = learn_scatter(1e-3 * rng.normal(size=(200, 1, 2)), 0, 1e-5 * np.ones((1, 2)))
    fitter = Fitter(ANYTHING, (1, 2))
    monkeypatch.setattr(Stuck, "smaller", Line(start, [one], []))
    both: Any = Line(start, [one, size * other], ["effect"])
    fit = fitter.start(both, np.array([[0.3, 0.7]]), scatter)
    court = Court(np.arange(50), fitter, fitter, np.zeros((1, 2)), np.zeros(1), ANYTHING)
    selection = Stuck(ANYTHING, None, 1, court, [], yardstick=MEASURED)
    found: Any = selection._idle(Trial(ANYTHING, fit, np.zeros(50), start, np.zeros(50)), ANYTHING, 1.0)
    assert (found is not None) is idle
    assert selection.steps > 0
    assert Stuck.smaller.sim.simulated_steps == 0
    if idle:
        assert found.xi == pytest.approx([0.3])


class Deeper(Stuck):
    """Beside contacts: a selection that knows gaps, and whether it would accept."""

    gaps: Any = None
    accepts: Any = None

    def _converged(self, fit) -> Any:
        return Trial(None, fit, np.zeros(50), fit.residuals, np.zeros(50))

    def gap_of(self, trial) -> Any:
        return self.gaps[trial]

    def accept(self, current, trials, first_gap, level=0.0, settled=None) -> Any:
        return self.accepts


@pytest.mark.parametrize(
    ("gap", "deeper", "accepts", "sigma", "idle"),
    [
        (1.0, 50.0, None, 1.0, True),
        (1.0, 50.0, "it", 1.0, False),
        (9.0, 50.0, None, 1.0, False),
        (1.0, 1.0, None, 1.0, False),  # chance
        (1.0, 50.0, None, None, False),
    ],
)
def test_an_effect_that_led_to_a_deeper_pit_does_nothing_where_it_is_not_asked_for_there(
    gap, deeper, accepts, sigma, idle
):
    """Only beside contacts, only where the others alone are better off than before, only if it is refused there."""
    rng = np.random.default_rng(31)
    one, other = rng.normal(size=(2, 50, 1, 2))
    start = -0.3 * one - 0.7 * other + 1e-3 * rng.normal(size=one.shape)
    scatter = learn_scatter(1e-3 * rng.normal(size=(200, 1, 2)), 0, 1e-5 * np.ones((1, 2)))
    fitter = Fitter(ANYTHING, (1, 2))
    both: Any = Line(start, [one, other], ["effect"])
    court = Court(np.arange(50), fitter, fitter, np.zeros((1, 2)), np.zeros(1), ANYTHING)
    sigmas = None if sigma is None else np.full(2, sigma)
    selection = Deeper(ANYTHING, None, 1, court, [], yardstick=MEASURED, sigma=sigmas)
    smaller: Any = Line(start, [one], [])
    selection.smaller, selection.accepts = smaller, accepts
    trial = Trial(ANYTHING, fitter.start(both, np.array([[0.3, 0.7]]), scatter), np.zeros(50), start, np.zeros(50))
    alone = fitter.start(smaller, np.array([[0.3]]), scatter)
    before = Trial(None, replace(alone, cost=alone.cost + deeper), np.zeros(50), start, np.zeros(50))

    class Gaps(dict):
        def __missing__(self, key):
            return gap

    selection.gaps = Gaps({before: 5.0})
    found: Any = selection._idle(trial, before, 10.0)
    assert (found is not None) is idle
    if idle:
        assert found.fit.replay is smaller


class Settled(Selection):
    """A selection that takes fits as they are."""

    def _converged(self, fit):
        return Trial(None, fit, np.zeros(50), fit.residuals, np.zeros(50))


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_what_does_nothing_on_longer_windows_is_not_carried_there(size):
    """Beside it the parameters got unstuck: where they are right alone it goes, where it does something it stays."""
    rng = np.random.default_rng(32)
    one, other = rng.normal(size=(2, 50, 1, 2))
    start = -0.3 * one - 0.7 * size * other + 1e-3 * rng.normal(size=one.shape)
    scatter = learn_scatter(1e-3 * rng.normal(size=(200, 1, 2)), 0, 1e-5 * np.ones((1, 2)))
    fitter = Fitter(ANYTHING, (1, 2))
    alone, both = (Line(start, slopes, []) for slopes in ([one], [one, size * other]))
    replays: list[Any] = [alone, both]
    base, beside = (fitter.start(r, np.array([[0.3, 0.7][: r.nfree]]), scatter) for r in replays)
    court = Court(np.arange(50), fitter, fitter, np.zeros((1, 2)), np.zeros(1), ANYTHING)
    selection = Settled(ANYTHING, None, 1, court, [], yardstick=MEASURED)
    first, found = selection._converged(base), selection._converged(beside)
    accepted = [Accepted(ANYTHING, found, (), (), ())]
    carried, kept = selection._carried(first, found, accepted, 1.0)
    assert kept == (accepted if size else [])
    assert (carried is first) is (not size)


class Unstuck(Selection):
    """A selection that finds a better place of the parameters at first, and nothing else."""

    better: Any = None

    def run(self, base, earlier=None, *, further=False):
        self.steps += 1
        self.ranking.append(base)
        return self.better, []


def test_selects_anew_from_where_the_parameters_got_unstuck(monkeypatch):
    """Gaps are counted by what the better place leaves, and nothing that was credited beside the other one stays."""
    rng = np.random.default_rng(31)
    noise, large, small = rng.normal(size=(3, 5, 40, 2, 3)) * np.array([1e-3, 1.0, 0.01])[:, None, None, None, None]
    stuck, better = (Trial(None, ANYTHING, np.zeros(40), held[0], np.zeros(40)) for held in (large, small))
    monkeypatch.setattr(Unstuck, "better", better)
    court: Any = SimpleNamespace(capped=0.0)
    stage = Stage(ANYTHING, large[0], stuck, court, Yardstick.of(noise, stuck.held, 0.0), np.ones(4))
    search = Search(ANYTHING, ANYTHING, [], np.zeros((1, 0)), 8, 0, ANYTHING, print)
    near, selection, final, accepted = search._select(
        stage, Unstuck(ANYTHING, None, 1, court, [], yardstick=stage.yardstick)
    )
    assert near.base is final is better
    assert not accepted
    assert selection.ranking == [better]
    assert selection.steps == 2
    assert near.yardstick.scale == pytest.approx(Yardstick.of(noise, better.held, 0.0).scale)
    assert selection.yardstick is near.yardstick
