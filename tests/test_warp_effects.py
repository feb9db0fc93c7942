"""Kernels of effects on Warp's CPU device, each against its numpy form in MujocoSimulator."""

import numpy as np
import pytest

from nfpde.effects import Effect, Quantity, effect, effect_names
from nfpde.effects.effect import overrides
from nfpde.errors import BadEffect
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.warp_effects import COMMANDS, STEPS
from tests.models import DOUBLE_PENDULUM, load, make_windows

# Positions and velocities of a few units after 20 physics steps in single precision, friction switching on the way
TOLERANCE = 5e-5

CASES = {
    "actuation_delay": ("*", {"delay": (0.0, 0.03)}),
    "actuator_bias": ("elbow_motor", {"offset": (-1.0, 1.0)}),
    "external_force": ("lower", {"force_x": (-5, 5), "force_y": (-5, 5), "force_z": (-5, 5)}),
    "joint_spring": ("*", {"stiffness": (0.0, 3.0), "rest": (-1.0, 1.0)}),
    "stribeck_friction": ("*", {"coulomb": (0.0, 0.5), "static": (0.0, 1.0), "speed": (0.05, 0.5)}),
}


def arm(*effects, **options):
    return WarpSimulator(load(DOUBLE_PENDULUM), None, effects, device="warp-cpu", check_influence=False, **options)


def neutral(sim):
    return np.array([q.neutral for e in sim.effects for q in e.quantities])


@pytest.mark.parametrize("name", CASES)
def test_kernel_equals_its_twin(name):
    """Random parameters, neutral ones, and bounds: predictions of windows with a history of commands."""
    target, bounds = CASES[name]
    sim = arm(effect(name, target, **bounds))
    windows = make_windows(sim.model, 4, 5, nsub=4, history=8)
    xi = np.vstack([sim.space.uniform(4, np.random.default_rng(0)), sim.space.low, sim.space.high, neutral(sim)])
    expected = sim.reference.predict(xi, windows)
    # the effect shows: a kernel that does nothing would not pass
    assert np.abs(expected[:4] - expected[-1]).max() > 100 * TOLERANCE
    np.testing.assert_allclose(sim.predict(xi, windows), expected, atol=TOLERANCE)
    scale = np.ones(4)
    np.testing.assert_allclose(sim.losses(xi, windows, scale), sim.reference.losses(xi, windows, scale), rtol=1e-3)


def test_every_kernel_has_a_case():
    """A kernel that nobody compares with its twin is not offered."""
    assert CASES.keys() == COMMANDS.keys() | STEPS.keys()
    assert CASES.keys() <= set(effect_names())


def test_effects_together():
    """All of them in one simulator, in series where they meet, with parameters that switch some off in some rows."""
    sim = arm(*(effect(name, target, **bounds) for name, (target, bounds) in CASES.items()))
    windows = make_windows(sim.model, 3, 4, nsub=3, history=12)
    xi = sim.space.uniform(6, np.random.default_rng(1))
    off = np.random.default_rng(2).random(xi.shape) < 0.4
    xi = np.clip(np.where(off, neutral(sim), xi), sim.space.low, sim.space.high)
    np.testing.assert_allclose(sim.predict(xi, windows), sim.reference.predict(xi, windows), atol=TOLERANCE)


@pytest.mark.parametrize("steps", [0.0, 1.0, 2.5, 3.0])
def test_delay_of_whole_and_broken_steps(steps):
    """A delay of k steps is a plain shift although k times the step is no float; between, commands are averaged."""
    sim = arm(effect("actuation_delay", "*", delay=(0.0, 0.1)))
    timestep = sim.model.opt.timestep
    windows = make_windows(sim.model, 3, 6, history=60)
    xi = [[steps * timestep]]
    np.testing.assert_allclose(sim.predict(xi, windows), sim.reference.predict(xi, windows), atol=TOLERANCE)


def test_an_effect_without_a_kernel_is_named():
    """What has no kernel is refused when the simulator is made, with what to do."""

    class Unheard(Effect):
        name = "unheard_of"
        kind = "joint"
        quantities = (Quantity("size", "Nm", 0.0, 1.0, neutral=0.0),)
        sentence = ""

        def step(self, world, rows, values):
            world.qfrc_applied[rows] += values

    with pytest.raises(BadEffect, match=r"unheard_of has no kernel for MuJoCo Warp \(step\); use device='cpu'"):
        arm(Unheard("elbow", size=(0.0, 1.0)))


def test_effects_without_a_kernel_are_those_that_say_so():
    """Of the library, only effects that act in other places than the model need a kernel."""
    for name in COMMANDS:
        assert overrides(effect(name, CASES[name][0], **CASES[name][1]), "command")
    for name in STEPS:
        assert overrides(effect(name, CASES[name][0], **CASES[name][1]), "step")
