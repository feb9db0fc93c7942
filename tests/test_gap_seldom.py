"""Effects that act in few of the windows: how they are looked for, ranked, proven and counted."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from nfpde.effects import effect
from nfpde.gap import diagnose_gap
from nfpde.gap.answer import ALARM, _verdict
from nfpde.gap.fit import Fitter
from nfpde.gap.levels import Yardstick
from nfpde.gap.noise import learn_scatter
from nfpde.gap.report import Level
from nfpde.gap.screen import screen
from nfpde.gap.trial import LEVEL, Court, Trial, likelihood_test
from tests.gap_straight import ByGain, Change
from tests.gap_systems import nominal, record

ANYTHING: Any = None
BLOCK = np.arange(40) // 4


def trial(effect, density, residuals):
    """A trial that leaves the same residuals in both halves."""
    fit: Any = SimpleNamespace(residuals=residuals, replay=SimpleNamespace(effects=()))
    return Trial(effect, fit, density, residuals, density)


def selection(noise, kind=ByGain, **more):
    """A selection whose windows show nothing but this noise (N, nv, C) where a model is right."""
    court = Court(BLOCK, ANYTHING, ANYTHING, np.zeros(noise.shape[1:]), np.zeros(0), ANYTHING)
    yardstick = Yardstick(np.ones(noise.shape[1:]), noise[None], 0.0)
    return kind(ANYTHING, None, 1, court, [], yardstick=yardstick, **more)


def test_likelihood_ratios_are_no_more_often_large_than_they_say():
    """Of draws of the null model at most a share p are called less likely than p; of the other model nearly all are."""
    rng = np.random.default_rng(20)
    shift, at = 0.5, np.arange(200) // 5

    def called(mean, p):
        draws = mean + rng.normal(size=(2000, 200))
        gains = norm.logpdf(draws, shift) - norm.logpdf(draws)
        return np.mean([likelihood_test(gain, at) <= p for gain in gains])

    assert called(0.0, 0.05) <= 0.05 + 4 * np.sqrt(0.05 * 0.95 / 2000)
    assert called(shift, 0.05) > 0.99


def test_one_block_is_no_proof():
    """However much is gained in it; in two blocks the lesser counts."""
    gain = np.where(BLOCK == 3, 100.0, 0.0)
    assert likelihood_test(gain, BLOCK) == 1.0
    assert likelihood_test(np.where(BLOCK == 5, 1.0, gain), BLOCK) == pytest.approx(np.exp(-4.0))


@pytest.mark.parametrize(("blocks", "left", "named"), [(2, 1.0, True), (2, 3.0, False), (1, 1.0, False)])
def test_what_acts_in_few_blocks_is_named_where_it_closes_the_gap(blocks, left, named):
    """Two blocks of ten are too few for any test of means; a gap that closes in them to the noise is proof."""
    rng = np.random.default_rng(21)
    noise = rng.normal(size=(40, 2, 4))
    acts = np.isin(BLOCK, range(blocks))[:, None, None]
    base = trial(None, np.zeros(40), np.where(acts, 30.0, 1.0) * noise)
    limit = effect("torque_limit", "bend", limit=(1.0, 9.0))
    gain = np.where(acts.ravel(), 50.0, -0.01)
    chosen = selection(noise)
    assert chosen.court.gain(trial(limit, gain, noise), base)[2] > LEVEL
    found = chosen.accept(base, [trial(limit, gain, np.where(acts, left, 1.0) * noise)], chosen.gap_of(base))
    assert (found is not None) is named


class Touching(ByGain):
    """A selection where contacts are: no model makes more of noise than another."""

    def floor(self, trial):
        return float(self.yardstick.floor.mean())

    def given_by_noise(self, trial: Any, current: Any, sigma: Any, gain: Any):
        return False


@pytest.mark.parametrize(("before", "left", "named"), [(4.0, 1.0, True), (4.0, 1.8, False), (1.8, 1.0, False)])
def test_beside_contacts_a_rare_effect_must_close_what_is_beyond_the_floor(before, left, named):
    """A floor is known to a factor there: what lies below that is not closed, nor is a tenth of a gap left over."""
    noise = np.random.default_rng(23).choice([-1.0, 1.0], size=(40, 2, 4))
    acts = np.isin(BLOCK, range(2))[:, None, None]
    base = trial(None, np.zeros(40), np.where(acts, before, 1.0) * noise)
    soft = effect("contact_softness", time_constant=(0.001, 0.1), damping_ratio=(0.1, 2.0))
    better = trial(soft, np.where(acts.ravel(), 50.0, -0.01), np.where(acts, left, 1.0) * noise)
    chosen = selection(noise, Touching, sigma=np.zeros(4))
    assert chosen.at_floor(better)
    assert (chosen.accept(base, [better], chosen.gap_of(base)) is not None) is named


def test_an_effect_is_worth_a_name_beside_a_rare_one_that_is_much_larger():
    """It leaves the few windows that hold nearly all of the gap as they are, and halves all others."""
    rng = np.random.default_rng(22)
    noise = rng.normal(size=(40, 2, 4))
    rare = np.arange(40)[:, None, None] == 7
    base, without_rare = np.where(rare, 1000.0, 4.0) * noise, np.where(rare, 1001.0, 2.0) * noise
    common = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    chosen = selection(noise)
    current, better = trial(None, np.zeros(40), base), trial(common, rng.uniform(1, 2, 40), without_rare)
    assert chosen.gap_of(better) > chosen.gap_of(current)
    found = chosen.accept(current, [better], chosen.gap_of(current))
    assert found is not None
    assert found[1].effect is common


def test_a_scatter_by_which_nothing_is_explained_does_not_rank():
    """With tails as heavy as a rare gap makes them, one nat is most of all: another scatter decides."""
    rng = np.random.default_rng(23)
    noise = 0.01 * rng.normal(size=(60, 1, 2))
    gap = np.where(np.arange(60)[:, None, None] < 3, 5.0, 0.0) * np.ones((60, 1, 2))
    start = noise + gap
    heavy, quiet = (learn_scatter(r, 0, 1e-6 * np.ones((1, 2))) for r in (1e3 * start, noise))
    right, idle = (effect("coulomb_friction", t, torque=(0.0, 1.0)) for t in ("elbow", "shoulder"))
    changes = {"elbow": Change(start, -gap), "shoulder": Change(start, -0.01 * gap)}
    empty: Any = SimpleNamespace(
        replay=None,
        xi=np.zeros(0),
        scatter=heavy,
        residuals=start,
        slopes=np.zeros((0, *start.shape)),
    )
    tried = [(e, np.array([[0.9]])) for e in (idle, right)]
    with_effect: Any = lambda e: changes[e.place]  # noqa: E731
    found = screen(Fitter(ANYTHING, (1, 2)), empty, tried, with_effect, quiet, 5.0)
    assert found[0].effect is right
    assert max(s.explained[0] for s in found) < 5.0
    assert all(len(s.starts) == 1 and s.starts[0][0] is quiet for s in found if s.share > 0.25)


def test_named_effects_that_leave_a_rare_gap_explain_nothing():
    """Where the mean over blocks is uncertain, windows far beyond all noise count, unless most of the gap is gone."""
    much, little = Level(1.0, 1.0, 1.04, 0.01), Level(1.0, 1.0, 0.05, 0.01)
    assert _verdict(much, 1.0, 0.1 * ALARM, named=True) == "unexplained"
    assert _verdict(much, 1.0, 10 * ALARM, named=True) == "effects"
    assert _verdict(little, 1.0, 0.1 * ALARM, named=True) == "effects"


def saturate_and_rub(model):
    model.actuator_forcelimited[1], model.actuator_forcerange[1] = 1, (-2.7, 2.7)
    model.dof_frictionloss[0] = 0.2


def test_a_limit_that_is_seldom_reached_is_found_beside_another_fault():
    """Friction at the shoulder, which acts always, and a torque limit at the elbow that few commands exceed."""
    data = record(saturate_and_rub, noise=1e-3, episodes=16)
    beyond = np.concatenate([np.abs(e.ctrl[:, 1]) > 2.7 for e in data])
    assert 0 < beyond.mean() < 0.02
    found = diagnose_gap(nominal(), data)
    assert found.verdict == "effects"
    assert {(c.effect, c.target) for c in found.effects} == {("coulomb_friction", "shoulder"), ("torque_limit", "bend")}
    limit = next(c for c in found.effects if c.effect == "torque_limit")
    assert limit.parameters["limit"].value == pytest.approx(2.7, rel=0.01)


class Straight:
    """A replay of one parameter: windows are what is left without it, and it changes all of them alike."""

    nfree, low, high = 1, np.zeros(1), np.ones(1)

    def inward(self, xi):
        return xi

    def outward(self, u):
        return u

    def residuals(self, xi, windows, horizons, force=None):
        return windows + xi[:, 0, None, None, None]


def test_a_few_windows_of_another_fault_do_not_speak_against_a_true_one():
    """What explains all but these is likelier, though it foretold next to no scatter, in which they cannot be."""
    rng = np.random.default_rng(33)
    fitted, held = -0.5 + 1e-3 * rng.normal(size=(2, 80, 1, 2))
    held[:8] += 0.4 * rng.normal(size=(8, 1, 2))
    floor = np.full((1, 2), 1e-5)
    windows: list[Any] = [fitted, held]
    fitter, other = (Fitter(w, (1, 2)) for w in windows)
    court = Court(np.arange(80) // 4, fitter, other, floor, np.zeros(1), ANYTHING)
    replay: Any = Straight()
    none, right = (fitter.start(replay, np.array([[xi]]), learn_scatter(fitted + xi, 0, floor)) for xi in (0.0, 0.5))
    better, base = court.judge(None, right), court.judge(None, none)
    assert court.gain(better, base)[2] < 1e-6
    assert (better.foretold - base.foretold).sum() < 0
    _, _, p = court.gain(base, better)
    assert p > 0.5
