"""Predictions that are kept: what they stand for, what is simulated, and what is forgotten."""

from dataclasses import replace

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap import diagnose_gap
from nfpde.gap.recall import Recall
from nfpde.gap.replay import Replay
from nfpde.gap.shelf import Shelf
from nfpde.parameters import Parameter, ParameterSpace
from tests.gap_cart import HORIZON, cart, cart_windows
from tests.gap_systems import nominal, record

SPACE = ParameterSpace([Parameter("body_mass", "cart", 0.5, 2.0, scale_inertia=False)])


@pytest.fixture
def windows():
    return cart_windows()


def replay(recall, effects=()):
    return Replay(cart(), SPACE, effects, nthread=1, recall=recall)


def asked(one, xi, windows, force=None):
    """Predictions, and how many windows were simulated for them."""
    before = one.sim.simulated_steps
    there = one.predict(xi, windows, force)
    return there, (one.sim.simulated_steps - before) / HORIZON


def test_only_what_is_new_is_simulated(windows):
    """Rows in any order and number are what a simulator gives that remembers nothing, to the bit."""
    recall, n = Recall(), len(windows)
    one = replay(recall)
    asked(one, np.array([[1.0], [1.5]]), windows)
    xi = np.array([[1.5], [0.7], [1.0], [0.7], [1.5]])
    there, simulated = asked(one, xi, windows)
    assert simulated == n  # 0.7, once
    np.testing.assert_array_equal(there, replay(None).sim.predict(np.hstack([xi, np.zeros((5, 1))]), windows))


def test_replays_with_the_same_effects_share(windows):
    """One made anew knows what another predicted; one with an effect, with another one, or alone, does not."""
    recall, n, xi = Recall(), len(windows), np.ones((1, 1))
    friction = effect("coulomb_friction", "slide", torque=(0.0, 1.0))
    same = effect("coulomb_friction", "slide", torque=(0.0, 1.0))
    other = effect("viscous_damping", "slide", damping=(0.0, 1.0))
    asked(replay(recall), xi, windows)
    assert asked(replay(recall), xi, windows)[1] == 0
    assert asked(replay(None), xi, windows)[1] == n
    both = np.array([[1.0, 0.3]])
    assert asked(replay(recall, [friction]), both, windows)[1] == n
    assert asked(replay(recall, [friction]), both, windows)[1] == 0
    assert asked(replay(recall, [same]), both, windows)[1] == 0
    assert asked(replay(recall, [other]), both, windows)[1] == n


@pytest.mark.parametrize(
    ("changed", "new"),
    [
        (lambda w: replace(w, state=np.concatenate([w.state[:, :1], w.state[:, 1:] + 1], axis=1)), False),
        (lambda w: replace(w, episode=w.episode + 1, row=w.row + 1), False),
        (lambda w: replace(w, state=w.state + np.array([0.0, 1e-12])), True),
        (lambda w: replace(w, ctrl=w.ctrl + 1e-12), True),
        (lambda w: replace(w, history=w.history + 1), True),
        (lambda w: replace(w, past=w.state[:, :1] - 1), True),
        (lambda w: replace(w, control_dt=0.02), True),
        (lambda w: w[1:], True),
        (lambda w: w[::-1], True),
    ],
)
def test_windows_are_told_apart_by_what_matters(windows, changed, new):
    """What was measured after the start matters not; start, commands, what was before and the time step do."""
    one, xi = replay(Recall()), np.ones((1, 1))
    one.predict(xi, windows)
    there = changed(windows)
    assert (asked(one, xi, there)[1] > 0) == new
    np.testing.assert_array_equal(one.predict(xi, there), replay(None).predict(xi, there))


def test_forces_are_told_apart(windows):
    one, xi = replay(Recall()), np.ones((1, 1))
    free = one.predict(xi, windows)
    pushed = one.predict(xi, windows, np.ones((1, 1)))
    # 1 N on 1 kg for three steps of .01 s, semi-implicit: .03 m/s
    np.testing.assert_allclose((pushed - free)[..., -1, 1], 0.03, rtol=1e-9)
    assert asked(one, xi, windows, np.zeros((1, 1)))[1] == 0


def test_the_oldest_is_forgotten(windows):
    """There is room for two predictions: the third costs the first its place, and the others stay."""
    n = len(windows)
    one = replay(Recall(most=2 * n * HORIZON * 2))
    for mass in (0.6, 0.7, 0.8):
        assert asked(one, np.array([[mass]]), windows)[1] == n
    assert asked(one, np.array([[0.7], [0.8]]), windows)[1] == 0
    assert asked(one, np.array([[0.6]]), windows)[1] == n
    assert asked(replay(Recall(most=1)), np.array([[0.6], [0.6]]), windows)[1] == n  # too large to keep; asked once


def test_what_is_given_out_may_be_written_to(windows):
    one, xi = replay(Recall()), np.array([[1.0], [1.5]])
    first = one.predict(xi, windows)
    sound = first.copy()
    first[:] = np.nan
    second = one.predict(xi, windows)
    np.testing.assert_array_equal(second, sound)
    second[:] = np.nan
    np.testing.assert_array_equal(one.predict(xi, windows), sound)


def test_nothing_asked_is_nothing_predicted(windows):
    assert replay(Recall()).predict(np.empty((0, 1)), windows).shape == (0, len(windows), HORIZON, 2)


def test_a_diagnosis_is_the_same_without_it(monkeypatch):
    """To the bit, with a tenth more of simulated steps at least."""
    data = record(force=lambda d: -3.0 * (d.qpos[1] - 0.2), noise=1e-3, seed=5)
    mass = ParameterSpace([Parameter("body_mass", "fore", 0.5, 2.0)])

    def answer():
        content = diagnose_gap(nominal(), data, mass, windows=60).to_json()
        del content["seconds"]
        return content.pop("simulated_steps"), content

    steps, kept = answer()
    monkeypatch.setattr(Shelf, "put", lambda *_: None)
    all_steps, simulated = answer()
    assert kept == simulated
    assert steps < 0.9 * all_steps
