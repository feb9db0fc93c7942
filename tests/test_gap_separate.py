"""Experiments that tell two explanations apart: what is said is what was simulated, beside the same other effects."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Windows
from nfpde.effects import effect
from nfpde.gap.answer import _beside_the_same
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.separate import _proposals, separating_experiment
from nfpde.gap.stage import first_fit
from tests.gap_systems import nominal, record

SERVO = """
<mujoco><worldbody><body pos="0 0 1"><joint name="h" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1"/></body></worldbody>
<actuator><position name="hold" joint="h" kp="20" {}/></actuator></mujoco>
"""


def windows_of(ctrl, control_dt):
    """Windows of five steps under commands (rows,)."""
    n = len(ctrl) // 5
    return Windows(
        np.zeros((n, 6, 2)),
        ctrl.reshape(n, 5, 1),
        np.empty((n, 0, 1)),
        control_dt,
        1,
        1,
        np.zeros(n, int),
        np.arange(n),
    )


def proposed(ctrl, control_dt=0.01, more="", steps=100):
    model = mujoco.MjModel.from_xml_string(SERVO.format(more))
    return _proposals(model, windows_of(ctrl, control_dt), steps)


WAVE = np.sin(np.arange(500))


@pytest.mark.parametrize(
    ("ctrl", "more"),
    [
        (2.2 + 0.2 * WAVE, ""),  # targets of a servo, far from zero
        (1.0 * (np.arange(500) % 10 < 2), ""),  # pulses, mostly off
        (WAVE, 'ctrllimited="true" ctrlrange="-1.2 1.2"'),
        (np.full(500, 3.0), ""),
        (1000.25 + 0.05 * WAVE, ""),
    ],
)
def test_words_say_what_was_simulated(ctrl, more):
    """The numbers are those of the commands, to three digits of their range."""
    for text, windows in proposed(ctrl, more=more):
        said = [float(x) for x in re.findall(r"(?:from|to|at) (-?[\d.]+)(?=[ ,])", text)]
        got = windows.ctrl[0, :, 0]
        width = max(np.ptp(said), 1e-3)
        if text.startswith("Hold"):
            np.testing.assert_allclose(got, said[0], rtol=1e-3)
        elif text.startswith("Ramp"):
            assert got[0] == pytest.approx(min(said), abs=0.01 * width)
            assert got.max() == pytest.approx(max(said), abs=0.02 * width)
        else:
            assert (got >= min(said) - 0.01 * width).all()
            assert (got <= max(said) + 0.01 * width).all()
            assert np.ptp(got) > 0.9 * width
        assert "starting at rest" in text
        if more:
            assert np.abs(got).max() <= 1.2


def test_several_commands_stand_in_brackets():
    """Behind what to do with them, and nothing between."""
    said = [text for text, _ in _proposals(nominal(), record(episodes=2, rows=60).windows(5), 100)]
    assert said
    assert all(re.match(r"[A-Z][^,]*(, up and down once)? \(\w+ (from|at) [-\d.]+", text) for text in said), said


def test_a_step_to_the_recorded_end_ends_there():
    """And not half-way, where most commands are zero; one that is twice as high stays in the control range."""
    ends = [w.ctrl.max() for t, w in proposed(1.0 * (np.arange(500) % 10 < 2)) if t.startswith("Step")]
    assert ends == pytest.approx([1.0, 1.5])
    limited = 'ctrllimited="true" ctrlrange="-1 1.2"'
    assert [w.ctrl.max() for t, w in proposed(WAVE, more=limited) if t.startswith("Step")] == pytest.approx(
        [1.0, 1.2], abs=1e-3
    )
    steps = {t.split(", after")[1].split(",")[0] for t, _ in proposed(WAVE) if t.startswith("Step")}
    assert steps == {" 0.2 s"}


@pytest.mark.parametrize(("control_dt", "rates"), [(0.001, {1, 2, 5}), (0.05, {1, 2, 5}), (0.1, {1, 2}), (1.0, set())])
def test_sines_are_those_that_the_control_rate_carries(control_dt, rates):
    """Of at least four commands a period: 5 Hz at ten commands a second would be nothing."""
    steps = max(round(1.0 / control_dt), 10)
    tried = proposed(WAVE, control_dt, steps=steps)
    assert {int(m[1]) for t, _ in tried if (m := re.search(r"of (\d+) Hz", t))} == rates


ARM = nominal()


@pytest.fixture(scope="module")
def arm():
    """Windows of an arm that rubs at the elbow and has a weak motor at the shoulder, and fits of effects to it."""

    def change(model):
        model.dof_frictionloss[1], model.actuator_gear[0, 0] = 0.3, 0.7

    recordings = cut_recordings(record(change, noise=1e-3, episodes=4, rows=150), 3, 0, 40)

    def fitted(effects, guess):
        return first_fit(Replay(ARM, None, effects, 1), recordings, np.array([guess]), capped=False)

    return recordings, fitted


def friction(most):
    return effect("coulomb_friction", "elbow", torque=(0.0, most))


WEAK = effect("motor_strength", "lift", scale=(0.3, 1.7))
SIGMA = np.array([0.0005, 0.0008, 0.003, 0.008])


def test_duration_is_a_second_at_any_control_rate(arm):
    """The time that is named is the time that was simulated."""
    recordings, fitted = arm
    one, other = (fitted([friction(8.0)], [x])[0].fit for x in (0.2, 0.2))
    other = SimpleNamespace(replay=other.replay, xi=np.array([4.0]))
    said: Any = separating_experiment(one, other, recordings.held, SIGMA, ("a", "b"))  # type: ignore[arg-type]
    assert "within 1 s the two differ" in said


def test_rivals_are_compared_beside_the_same_effects(arm):
    """The same friction twice: found beside a weak motor and without, no experiment tells it from itself."""
    recordings, fitted = arm
    alone, _ = fitted([friction(8.0)], [0.2])
    rival, _ = fitted([WEAK, friction(4.0)], [0.8, 0.2])
    final, court = fitted([friction(8.0), WEAK], [0.2, 0.8])
    final = replace(final, fit=court.converged(final.fit))
    smaller, _ = fitted([WEAK], [0.8])
    counted = []
    selection = SimpleNamespace(replay=lambda e: Replay(ARM, None, e, 1), court=court, count=counted.append)
    outcome: Any = SimpleNamespace(
        accepted=[SimpleNamespace(trial=alone)], without=[smaller], final=final, selection=selection
    )
    named: Any = SimpleNamespace(effect=rival.fit.replay.effects[-1], fit=rival.fit)
    assert "times the noise" in separating_experiment(alone.fit, rival.fit, recordings.held, SIGMA, ("a", "b"))
    fits = _beside_the_same(outcome, 0, named)
    assert "No excitation tried" in separating_experiment(*fits, recordings.held, SIGMA, ("a", "b"))
    assert len(counted) == 1
    same: Any = SimpleNamespace(effect=named.effect, fit=fitted([friction(4.0)], [0.2])[0].fit)
    assert _beside_the_same(outcome, 0, same) == (alone.fit, same.fit)
