"""Which candidate is named, and which count as its equals."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student

from nfpde.effects import effect
from nfpde.gap.fit import Fitter
from nfpde.gap.found import Found, _differs, surely
from nfpde.gap.levels import Yardstick
from nfpde.gap.select import Selection
from nfpde.gap.trial import LEVEL, Court, Trial
from tests.gap_straight import ByGain
from tests.gap_systems import record

ANYTHING: Any = None
BLOCK = np.arange(40) // 4


def trial(effect, density, residuals):
    """A trial that leaves the same residuals in both halves."""
    fit: Any = SimpleNamespace(residuals=residuals, cost=-float(density.sum()))
    return Trial(effect, fit, density, residuals, density)


def test_what_leaves_the_gap_is_not_named():
    """Of two candidates the one that closes the gap is accepted, though the other fits better; alone it is refused."""
    rng = np.random.default_rng(8)
    block = np.arange(40) // 4
    held, gained = 3 * rng.normal(size=(40, 2, 4)), rng.uniform(1, 2, 40)
    court = Court(block, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)
    yardstick = Yardstick(np.ones((2, 4)), rng.normal(size=(1, 40, 2, 4)))
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick)
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    damping = effect("viscous_damping", "elbow", damping=(0.0, 1.0))
    base = trial(None, np.zeros(40), held)
    idle = trial(friction, 5 * gained, held)
    useful = trial(damping, gained, held / 3)
    found = selection.accept(base, [idle, useful], selection._gap(base))
    assert found is not None
    assert found[1].effect is damping
    assert selection.accept(base, [idle], selection._gap(base)) is None


def test_a_second_effect_need_not_be_large_beside_the_first():
    """A hundredth of the first gap, and most of what is left, is accepted; what hides in the noise is not."""
    rng = np.random.default_rng(9)
    noise, first_gap = rng.normal(size=(40, 2, 4)), 1000.0
    court = Court(np.arange(40) // 4, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=Yardstick(np.ones((2, 4)), noise[None]))
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    for size, named in ((3.0, True), (1.02, False)):
        left = trial(None, np.zeros(40), size * noise)
        found = selection.accept(left, [trial(friction, rng.uniform(1, 2, 40), noise)], first_gap)
        assert (found is not None) is named


@pytest.mark.parametrize(("size", "at_floor"), [(1.2, True), (1.4, False)])
def test_beside_contacts_the_floors_own_error_is_not_explained(size, at_floor, monkeypatch):
    """What may be an error of the floor, half of it, is left alone beside contacts; in smooth motion it is not."""
    noise = np.random.default_rng(11).normal(size=(40, 2, 4))
    noise /= np.sqrt((noise**2).mean())
    monkeypatch.setattr("nfpde.gap.acceptance.noise_of", lambda *a: 0.5 * noise[None])
    left, yardstick = trial(None, np.zeros(40), size * noise), Yardstick(np.ones((2, 4)), noise[None], 0.0)
    for sigma in (np.ones(4), None):
        court = Court(np.arange(40) // 4, ANYTHING, Fitter(ANYTHING, (1,)), np.zeros((2, 4)), np.zeros(0), ANYTHING)
        selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=sigma)
        assert selection.at_floor(left) is (sigma is not None and at_floor)
    monkeypatch.setattr("nfpde.gap.acceptance.noise_of", lambda *a: 2.0 * noise[None])
    assert ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=np.ones(4)).at_floor(left)


@pytest.mark.parametrize(("few", "named"), [(40.0, True), (50.0, True), (90.0, False), (400.0, False)])
def test_most_windows_must_gain_more_than_a_few_lose(few, named):
    """Squares of 1 are halved in 36 windows of 40, and from 25 become `few` in the others, which make up the mean.

    The geometric mean falls by the factor .5**.9 * (few / 25)**.1, and the mean of 3.4 becomes (18 + 4 few) / 40.
    The product of the factors is below one up to a `few` of 54.
    """
    last = (np.arange(40) >= 36)[:, None, None]
    before, after = np.where(last, 25.0, 1.0), np.where(last, few, 0.5)
    residuals = [np.sqrt(squares) * np.ones((40, 1, 2)) for squares in (before, after)]
    yardstick = Yardstick(np.ones((1, 2)), np.zeros((1, 40, 1, 2)), 0.0)
    selection = ByGain(ANYTHING, None, 1, ANYTHING, [], yardstick=yardstick)
    current, found = (trial(None, np.zeros(40), r) for r in residuals)
    assert selection.shrinks(found, current, 3.4) is named


@pytest.mark.parametrize("contacts", [True, False])
@pytest.mark.parametrize(("left", "named"), [(0.9, False), (3.0, True)])
def test_what_rounding_may_do_is_nobodys_work(left, named, contacts):
    """Without noise a gap is counted in rounding: one of that size is next to nothing, one of its threefold may be."""
    rounding, still = np.full((1, 2), 1e-9), np.zeros((1, 400, 1, 2))
    yardstick = Yardstick.of(still, still[0], 0.0, rounding)
    assert float(yardstick.floor.mean()) == pytest.approx(1.0)
    # the mean of 800 squares of normal numbers errs by sqrt(2 / 800)
    assert yardstick.rounding == pytest.approx(1.0, abs=5 * np.sqrt(2 / 800))
    sigma = np.zeros(2) if contacts else None
    selection = ByGain(ANYTHING, None, 1, ANYTHING, [], yardstick=yardstick, sigma=sigma)
    before, after = (trial(None, np.zeros(400), 1e-9 * np.sqrt(gap) + still[0]) for gap in (left, 0.1))
    assert selection.shrinks(after, before, 14.0) is named
    noisy = Yardstick.of(still + 1.0, still[0], 0.0, rounding)
    assert noisy.rounding < 1e-17


@pytest.mark.parametrize(
    ("size", "behind", "contacts", "equal"),
    [(1.02, 3.0, True, True), (1.02, 3.0, False, False), (1.8, 1e-4, True, False), (1.8, 1e-4, False, True)],
)
def test_beside_contacts_equals_are_told_by_what_they_leave(size, behind, contacts, equal, monkeypatch):
    """Who leaves as little as the best is its equal whatever the density says, who leaves much more is not."""
    rng = np.random.default_rng(12)
    noise = rng.normal(size=(40, 2, 4))
    noise /= np.sqrt((noise**2).mean())
    monkeypatch.setattr("nfpde.gap.acceptance.noise_of", lambda *a: noise[None])
    one, other = (
        effect(n, "elbow", **q)
        for n, q in (("coulomb_friction", {"torque": (0, 1)}), ("armature", {"inertia": (0, 1)}))
    )
    density = rng.uniform(9, 11, 40)
    trials = [trial(one, density, noise), trial(other, density - behind - 1e-6 * rng.normal(size=40), size * noise)]
    court = Court(np.arange(40) // 4, ANYTHING, Fitter(ANYTHING, (1,)), np.zeros((2, 4)), np.zeros(0), ANYTHING)
    yardstick = Yardstick(np.ones((2, 4)), noise[None], 0.0)
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=np.ones(4) if contacts else None)
    found = selection.accept(trial(None, np.zeros(40), 4.0 * noise), trials, 16.0)
    assert found is not None
    assert found[1].effect is one
    assert (trials[1] in found[1].rivals) is equal
    assert (trials[1] in found[1].close) is (size < 1.5)  # 1.8 leaves 3.2 of 16, the best 1


@pytest.mark.parametrize(("explained", "equal"), [(0.2, False), (0.8, True)])
def test_who_explains_next_to_nothing_is_no_equal_of_who_explains_little(explained, equal):
    """Beside contacts an error of the floor is a tenth of it, and of a gap of 1.06 the best leaves 1.0."""
    rng = np.random.default_rng(13)
    one, other = (
        effect(n, "elbow", **{q: (0, 1)}) for n, q in (("coulomb_friction", "torque"), ("armature", "inertia"))
    )
    noise = np.ones((40, 2, 4))
    density = rng.uniform(9, 11, 40)
    left = 1.06 - 0.06 * explained
    trials = [trial(one, density, noise), trial(other, density - 5.0, np.sqrt(left) * noise)]
    court = Court(np.arange(40) // 4, ANYTHING, Fitter(ANYTHING, (1,)), np.zeros((2, 4)), np.zeros(0), ANYTHING)
    yardstick = Yardstick(np.ones((2, 4)), noise[None], 0.0)
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=np.ones(4))
    assert selection._equal(1.06, trials[0], trials[1], False) is equal


@pytest.mark.parametrize(("size", "contacts", "named"), [(3.0, True, 0), (1.02, True, 1), (3.0, False, 1)])
def test_beside_contacts_fewer_parameters_are_preferred_where_they_explain_the_same(size, contacts, named, monkeypatch):
    """Of a gap of 16 the best leaves 1, and who has fewer parameters and as much density leaves 9, or next to 1."""
    rng = np.random.default_rng(14)
    noise = rng.normal(size=(40, 2, 4))
    noise /= np.sqrt((noise**2).mean())
    monkeypatch.setattr("nfpde.gap.acceptance.noise_of", lambda *a: noise[None])
    bounds = {"coulomb": (0.0, 1.0), "static": (0.0, 1.0), "speed": (0.01, 1.0)}
    effects = [effect("stribeck_friction", "elbow", **bounds), effect("coulomb_friction", "elbow", torque=(0.0, 1.0))]
    density = rng.uniform(9, 11, 40)
    apart = rng.normal(size=40)
    densities = density, density - 1e-4 + 0.1 * (apart - apart.mean())
    trials = [trial(e, d, s * noise) for e, d, s in zip(effects, densities, (1.0, size), strict=True)]
    court = Court(np.arange(40) // 4, ANYTHING, Fitter(ANYTHING, (1,)), np.zeros((2, 4)), np.zeros(0), ANYTHING)
    yardstick = Yardstick(np.ones((2, 4)), noise[None], 0.0)
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=np.ones(4) if contacts else None)
    found = selection.accept(trial(None, np.zeros(40), 4.0 * noise), trials, 16.0)
    assert found is not None
    assert found[1].effect is effects[named]


def test_a_sure_effect_is_named_beside_a_better_fit_that_is_not_sure():
    """Where most density is gained in one block alone, the candidate that gains in every block is accepted."""
    rng = np.random.default_rng(10)
    block = np.arange(40) // 4
    held = 3 * rng.normal(size=(40, 2, 4))
    court = Court(block, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)
    selection = ByGain(
        ANYTHING, None, 1, court, [], yardstick=Yardstick(np.ones((2, 4)), rng.normal(size=(1, 40, 2, 4)))
    )
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    damping = effect("viscous_damping", "elbow", damping=(0.0, 1.0))
    base = trial(None, np.zeros(40), held)
    lucky = trial(friction, np.where(block == 0, 40.0, rng.normal(size=40)), held / 3)
    steady = trial(damping, rng.uniform(1, 2, 40), held / 3)
    found = selection.accept(base, [lucky, steady], selection._gap(base))
    assert found is not None
    assert found[1].effect is damping
    assert selection.accept(base, [lucky], selection._gap(base)) is None


def test_later_looks_ask_for_more():
    """A gain that is sure at one level of probability is none at half of it."""
    rng = np.random.default_rng(12)
    noise = rng.normal(size=(40, 2, 4))
    court = Court(np.arange(40) // 4, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=Yardstick(np.ones((2, 4)), noise[None]))
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    of_blocks = rng.normal(size=10)
    of_blocks = 1.0 + 0.75 * (of_blocks - of_blocks.mean()) / of_blocks.std(ddof=1)
    base, better = trial(None, np.zeros(40), 3.0 * noise), trial(friction, np.repeat(of_blocks, 4), 2.0 * noise)
    # Wilcoxon gives about as much; twice for two tests, and twice for the slope, which says nothing
    p = 4.0 * float(student.sf(np.sqrt(10) / 0.75, 9))
    assert selection.accept(base, [better], 9.0, 1.3 * p) is not None
    assert selection.accept(base, [better], 9.0, 0.7 * p) is None
    assert selection.accept(base, [better, better], 9.0, 1.3 * p) is None


class BySlope(Selection):
    """A selection to which slopes of the windows say yes, whatever they are asked."""

    def slope(self, trial, current):
        return 0.0


@pytest.mark.parametrize("contacts", [True, False])
def test_slopes_are_not_asked_beside_contacts(contacts, monkeypatch):
    """A candidate that gains a tenth of a standard error of its gains: the slope alone can speak for it."""
    monkeypatch.setattr("nfpde.gap.acceptance.noise_of", lambda *a: noise[None])
    rng = np.random.default_rng(15)
    noise, of_blocks = rng.normal(size=(40, 2, 4)), rng.normal(size=10)
    of_blocks += 0.1 * of_blocks.std(ddof=1) / np.sqrt(10) - of_blocks.mean()
    court = Court(BLOCK, ANYTHING, Fitter(ANYTHING, (1,)), np.zeros((2, 4)), np.zeros(0), ANYTHING)
    yardstick, sigma = Yardstick(np.ones((2, 4)), noise[None], 0.0), np.ones(4) if contacts else None
    selection = BySlope(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=sigma)
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    base, better = trial(None, np.zeros(40), 30 * noise), trial(friction, np.repeat(of_blocks, 4), 20 * noise)
    found = selection.accept(base, [better], 900.0)
    assert (found is None) is contacts


def test_all_looks_together_have_one_level():
    """However many there are."""
    selection, spent = ByGain(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING), 0.0
    assert selection.level == LEVEL
    for _ in range(20):
        selection = selection.looking_again()
        spent += selection.level
    assert spent == pytest.approx(LEVEL, rel=1e-5)
    assert spent < LEVEL


@pytest.mark.parametrize(
    ("left", "there", "named"),
    [
        ((0.5, 0.5), None, True),
        ((1.0, 1.0), None, False),
        ((1.2, 1.2), None, False),
        ((1.0, 0.3), None, True),  # it acts in windows that were fitted only
        ((1.0, 1.0), (0.5, 0.5), True),
        ((1.0, 1.0), (1.0, 0.3), False),
        ((1.2, 0.5), (0.5, 0.5), False),  # worse of all joints
    ],
)
def test_what_leaves_the_gap_beside_contacts_is_nothing(left, there, named):
    """By all joints, or by those that told it (`there`); in smooth motion tests are exact, and what they say stands.

    What is left, as a share of the residuals: of windows held out, and of those that were fitted.
    """
    rng = np.random.default_rng(13)
    noise, data = rng.normal(size=(40, 2, 4)), record()

    def stage(held, fitted):
        fit: Any = SimpleNamespace(residuals=fitted * rng.permutation(noise))
        after = Trial(None, fit, np.zeros(40), held * rng.permutation(noise), np.zeros(40))
        windows = SimpleNamespace(fit=data.windows(2, stride=1)[np.arange(40)], block=BLOCK)
        made: Any = SimpleNamespace(
            base=trial(None, np.zeros(40), noise),
            recordings=windows,
            yardstick=Yardstick(np.ones((2, 4)), noise[None]),
            shown=lambda *_, **__: after,
        )
        return made, after

    every, final = stage(*left)
    by = None if there is None else stage(*there)[0]
    effects: Any = ["effect"]
    for sigma, stands in ((np.ones(4), named), (None, True)):
        chosen = ByGain(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=sigma)
        found = surely(every, Found(ANYTHING, ANYTHING, chosen, final, effects, False, by), 0)
        assert found.accepted == (effects if stands else [])
        assert found.final is (final if stands else every.base)
        assert found.by is (by if stands else None)


@pytest.mark.parametrize(
    ("away", "left", "named"),
    [
        (2.1, 0.995, True),
        (-2.1, 0.995, True),
        (1.8, 0.995, False),
        (1.8, 0.95, True),  # a tenth of the gap is worth a name
        (2.1, 1.0, False),  # none of it is not
    ],
)
def test_what_shrinks_the_gap_too_little_for_a_name_must_differ_from_nothing(away, left, named, monkeypatch):
    """A factor so many standard errors from one, that leaves this share of every residual; its neighbour is sure."""
    noise = np.random.default_rng(14).normal(size=(40, 2, 4))
    scale, bias = effect("sensor_scale", "bend", scale=(0.5, 2.0)), effect("actuator_bias", "bend", offset=(-1.0, 1.0))
    replay = SimpleNamespace(effects=(scale, bias), columns=lambda i: slice(i + 1, i + 2))
    fit: Any = SimpleNamespace(residuals=left * noise, replay=replay, xi=np.array([5.0, 1.0 + 0.01 * away, 0.5]))
    final = Trial(None, fit, np.zeros(40), left * noise, np.zeros(40))
    errors = np.array([9.0, 0.01, 0.01])
    monkeypatch.setattr("nfpde.gap.found.standard_errors", lambda court, fit: errors)
    near: Any = SimpleNamespace(
        base=trial(None, np.zeros(40), noise),
        court=SimpleNamespace(fitter=SimpleNamespace(resolved=lambda fit: fit)),
        recordings=SimpleNamespace(fit=record().windows(2, stride=1)[np.arange(40)], block=BLOCK),
        yardstick=Yardstick(np.ones((2, 4)), noise[None]),
        shown=lambda trial, refitted: trial,
    )
    chosen = ByGain(ANYTHING, None, 1, ANYTHING, [], yardstick=ANYTHING, sigma=np.ones(4))
    effects: Any = ["scale", "bias"]
    found = surely(near, Found(ANYTHING, near, chosen, final, effects, False), 0)
    assert bool(found.accepted) is named


@pytest.mark.parametrize(("away", "named"), [(2.1, True), (1.8, False)])
def test_a_limit_must_differ_from_the_least_that_limits(away, named):
    """None at all is far beyond all bounds: a limit so many standard errors below the end of its bounds."""
    limit = effect("torque_limit", "bend", limit=(0.1, 5.0))
    replay = SimpleNamespace(effects=(limit,), columns=lambda i: slice(0, 1))
    fit: Any = SimpleNamespace(replay=replay, xi=np.array([5.0 - 0.3 * away]))
    near: Any = SimpleNamespace(
        court=SimpleNamespace(fitter=SimpleNamespace(resolved=lambda fit: fit)),
        shown=lambda trial, refitted: trial,
    )
    found: Any = SimpleNamespace(near=near, final=SimpleNamespace(fit=fit))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nfpde.gap.found.standard_errors", lambda court, fit: np.array([0.3]))
        assert _differs(found) is named
