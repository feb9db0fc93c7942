"""Simulators of one family run each other's batches: the same bits as with batches of their own."""

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import warp_family, warp_model
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.warp_batch import WarpBatch
from tests.device import WARP
from tests.models import DOUBLE_PENDULUM, load, make_windows

SPACE = ParameterSpace([Parameter("body_mass", "upper", 0.5, 2.0)])

ARM = DOUBLE_PENDULUM.replace('<motor joint="shoulder"', '<motor name="shoulder_motor" joint="shoulder"')

JOINTS, MOTORS = ("shoulder", "elbow"), ("shoulder_motor", "elbow_motor")

CASES = {
    "actuator_bias": (MOTORS, {"offset": (0.2, 1.0)}),
    "armature": (JOINTS, {"inertia": (0.01, 0.3)}),
    "backlash": (MOTORS, {"width": (0.01, 0.1)}),
    "dead_zone": (MOTORS, {"half_width": (0.1, 0.5)}),
    "external_force": (("upper", "lower"), {f"force_{axis}": (1, 5) for axis in "xyz"}),
    "joint_offset": (JOINTS, {"offset": (0.1, 0.5)}),
    "joint_spring": (JOINTS, {"stiffness": (0.5, 3.0), "rest": (-1.0, 1.0)}),
    "load_friction": (JOINTS, {"base": (0.1, 0.3), "share": (0.1, 0.9)}),
    "sensor_scale": (JOINTS, {"scale": (1.1, 1.7)}),
    "stribeck_friction": (JOINTS, {"coulomb": (0.1, 0.5), "static": (0.1, 1.0), "speed": (0.05, 0.5)}),
    "viscous_damping": (JOINTS, {"damping": (0.1, 2.0)}),
}


def at(name, place: int | None = 0):
    """An effect at the first or second of its places, or at all of them."""
    places, bounds = CASES[name]
    return effect(name, "*" if place is None else places[place], **bounds)


def arm(*effects, space=SPACE, **options):
    return WarpSimulator(load(ARM), space, effects, device=WARP, check_influence=False, **options)


def vectors(sim, seed=0):
    return sim.space.uniform(4, np.random.default_rng(seed))


@pytest.fixture
def made(monkeypatch):
    """Counts the batches that are made; none is kept to begin with."""
    warp_family.free_shared(arm().device)
    real, count = WarpBatch.__init__, [0]

    def init(self, *args):
        count[0] += 1
        real(self, *args)

    monkeypatch.setattr(WarpBatch, "__init__", init)
    return count


@pytest.mark.parametrize("name", CASES)
def test_an_effect_that_acts_elsewhere_takes_the_batch_over(made, name):
    """Nothing is made for the second place, and each place has its own answer, in turn and again."""
    here, there = (arm(at(name, place)) for place in (0, 1))
    windows = make_windows(here.model, 5, 4, nsub=2, history=10)
    expected = here.predict(vectors(here), windows)
    count = made[0]
    found = there.predict(vectors(there), windows)
    assert made[0] == count
    assert np.abs(found - expected).max() > 1e-6
    np.testing.assert_allclose(found, there.reference.predict(vectors(there), windows), atol=2e-5)
    np.testing.assert_array_equal(here.predict(vectors(here), windows), expected)
    assert made[0] == count
    warp_family.free_shared(here.device)
    np.testing.assert_array_equal(there.predict(vectors(there), windows), found)
    assert made[0] == count + 1


def test_other_families_have_their_own(made):
    """Another model, kind of effect, or number of elements: nothing is taken over; with other parameters all is."""
    first = arm(at("joint_offset"))
    windows = make_windows(first.model, 5, 4)
    first.predict(vectors(first), windows)
    heavy = load(ARM.replace('mass="1.2"', 'mass="1.3"'))
    others = [
        WarpSimulator(heavy, SPACE, first.effects, device=WARP, check_influence=False),
        arm(at("sensor_scale")),
        arm(at("joint_offset", None)),
        arm(at("joint_offset"), at("joint_offset", 1)),
    ]
    damped = arm(*first.effects, space=ParameterSpace([Parameter("dof_damping", "elbow", 0.1, 2.0)]))
    for other, new in [*((o, 1) for o in others), (damped, 0)]:
        count = made[0]
        found = other.predict(vectors(other), windows)
        assert made[0] == count + new
        np.testing.assert_allclose(found, other.reference.predict(vectors(other), windows), atol=2e-5)


def test_losses_on_the_device_are_nobody_elses(made):
    """What a call left in a batch's memory stays there while another simulator runs."""
    one, two = arm(), arm()
    windows = make_windows(one.model, 5, 4)
    kept = one.losses_on_device(vectors(one), windows, np.ones(4))
    before = kept.numpy().copy()
    two.losses(vectors(two, seed=1), windows, np.ones(4))
    np.testing.assert_array_equal(kept.numpy(), before)


def test_few_are_kept(made, monkeypatch):
    """Beyond their number, and beyond their memory, the oldest are given back; whoever had one makes it anew."""
    monkeypatch.setattr(warp_family, "MOST_SHARED", 2)
    sims = [arm(at(name)) for name in ("joint_offset", "sensor_scale", "joint_spring")]
    windows = make_windows(sims[0].model, 5, 4)
    found = [sim.predict(vectors(sim), windows) for sim in sims]
    kept = warp_family._SHARED[sims[0].device.alias]
    assert len(kept) == 2
    assert next(iter(sims[0]._batches.kept.values())).freed
    count = made[0]
    np.testing.assert_array_equal(sims[2].predict(vectors(sims[2]), windows), found[2])
    assert made[0] == count
    np.testing.assert_array_equal(sims[0].predict(vectors(sims[0]), windows), found[0])
    assert made[0] == count + 1
    assert len(kept) == 2
    sims[0]._batches.memory = 1
    sims[0].predict(vectors(sims[0]), windows[np.arange(3)])
    assert len(kept) == 1


def test_switches_are_looked_up_once(monkeypatch):
    """A simulator whose fields and their signs were seen before builds no changed model."""
    monkeypatch.setattr(warp_model, "_FLAGS", {})
    real, built = warp_model._put, []
    monkeypatch.setattr(warp_model, "_put", lambda model: built.append(model) or real(model))
    first = arm(at("armature", None))
    count = len(built)
    assert count
    again = arm(at("armature", None))
    assert len(built) == count
    assert again._model.flags == first._model.flags
