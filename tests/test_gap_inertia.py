"""Masses that are free beside inertias that follow them, or do not: nobody has to know which."""

import mujoco
import numpy as np
import pytest

from nfpde import MujocoSimulator, diagnose_gap, effect
from nfpde.errors import BadParameter
from nfpde.gap.inertia import NAME, inertia_of
from nfpde.gap.replay import Replay
from nfpde.parameters import Parameter, ParameterSpace
from tests.gap_systems import nominal, record

MASS = Parameter("body_mass", "fore", low=0.5, high=1.6)
ALONE = Parameter("body_mass", "fore", low=0.5, high=1.6, scale_inertia=False)
SHARE = f"{NAME}:fore"


def heavier(model, *, follows):
    body = model.body("fore").id
    model.body_mass[body] *= 1.3
    if follows:
        model.body_inertia[body] *= 1.3


@pytest.mark.parametrize(("share", "mass"), [(1.0, MASS), (0.0, ALONE)])
def test_its_ends_are_the_two_ways_to_write_a_mass(share, mass):
    """The replay of a free mass at either end is the simulator's own, to the last bit; beside a load too."""
    windows = record(episodes=1, rows=60).windows(8)
    load = effect("payload", "fore", mass=(0, 1), position_x=(-1, 1), position_y=(-1, 1), position_z=(-1, 1))
    there = [0.2, 0.05, 0.0, -0.3]
    for added, values in (((), []), ((load,), there)):
        found = Replay(nominal(), ParameterSpace([MASS]), added).predict(np.array([[1.3, share, *values]]), windows)
        plain = MujocoSimulator(nominal(), ParameterSpace([mass]), added, check_influence=False)
        np.testing.assert_array_equal(found, plain.predict(np.array([[1.3, *values]]), windows))


def test_it_stands_beside_free_masses_that_take_their_inertia_along_only():
    damping = Parameter("dof_damping", "elbow", low=0.0, high=1.0)
    for space in (None, ParameterSpace([damping]), ParameterSpace([ALONE])):
        assert inertia_of(nominal(), space) == {}
        assert Replay(nominal(), space, []).nbase == (0 if space is None else 1)
    both = ParameterSpace([damping, MASS, Parameter("body_mass", "upper", low=0.5, high=2.0, relative=True)])
    replay = Replay(nominal(), both, [effect("armature", "elbow", inertia=(0, 1))])
    assert replay.nbase == 5
    shares = [f"{NAME}:fore", f"{NAME}:upper"]
    assert [p.name for p in replay.parameters] == [*both.names, *shares, "armature.inertia:elbow"]
    np.testing.assert_array_equal(replay.sim.nominal()[3:5], 1.0)


def test_nobody_is_asked_about_the_inertia_of_what_never_turns():
    """A carriage on rails has none that matters; what hangs from it, or flies, has. So has a mass of both together."""
    model = mujoco.MjModel.from_xml_string("""
      <mujoco><worldbody>
        <body name="cart"><joint type="slide"/><geom size=".1"/>
          <body name="lift"><joint type="slide" axis="0 0 1"/><geom size=".1"/>
            <body name="arm"><joint/><geom size=".1"/><body name="hand"><geom size=".1"/></body></body></body></body>
        <body name="ball"><joint type="ball"/><geom size=".1"/></body>
        <body name="drone"><freejoint/><geom size=".1"/></body>
      </worldbody></mujoco>""")
    every = [Parameter("body_mass", model.body(b).name, low=1, high=9) for b in range(1, model.nbody)]
    asked = inertia_of(model, ParameterSpace(every))
    assert [p.target for p in asked] == ["arm", "hand", "ball", "drone"]
    assert [e.parameters[0].name for e in asked.values()] == [f"{NAME}:{p.target}" for p in asked]
    together = ParameterSpace([Parameter("body_mass", ("cart", "arm"), low=0.5, high=2, relative=True)])
    assert [e.parameters[0].name for e in inertia_of(model, together).values()] == [f"{NAME}:cart+arm"]


def test_what_weighs_nothing_is_refused_as_before():
    """A mass of zero has no inertia, whatever else is asked."""
    space = ParameterSpace([Parameter("body_mass", "fore", low=0.0, high=1.6)])
    with pytest.raises(BadParameter):
        MujocoSimulator(nominal(), space)
    with pytest.raises(BadParameter):
        Replay(nominal(), space, [])


def test_every_mass_has_a_share_of_its_own():
    """Of two bodies one is of other material, the other carries a load in its centre: no effect is there."""

    def change(model):
        heavier(model, follows=False)
        upper = model.body("upper").id
        model.body_mass[upper] *= 1.3
        model.body_inertia[upper] *= 1.3

    masses = ParameterSpace([MASS, Parameter("body_mass", "upper", low=0.8, high=2.5)])
    found = diagnose_gap(nominal(), record(change, noise=1e-3, seed=6), masses)
    assert found.verdict == "no_gap"
    assert found.effects == []
    assert found.base[SHARE].high < 0.5


@pytest.mark.parametrize("follows", [True, False])
def test_a_mass_is_told_and_no_load_is_named_whether_the_inertia_follows_or_not(follows):
    """A control: only the mass is off; the report says which way it was."""
    dataset = record(lambda model: heavier(model, follows=follows), noise=1e-3, seed=4)
    found = diagnose_gap(nominal(), dataset, ParameterSpace([MASS]))
    assert found.verdict == "no_gap"
    assert found.effects == []
    mass, share = found.base["body_mass:fore"], found.base[SHARE]
    assert mass.low <= 1.3 <= mass.high
    assert mass.high - mass.low < 0.01
    assert share.low - 1e-9 <= float(follows) <= share.high + 1e-9
    assert share.high - share.low < 0.2
    assert not share.at_bound
    said = [line for line in found.summary if "scale_inertia = false" in line]
    assert len(said) == (0 if follows else 1)
    assert not [line for line in found.summary if "leans on" in line]


def test_a_load_beside_a_mass_that_is_off_is_found_all_the_same():
    """The inertia's share does not soak up what a point mass at the end of the arm does."""

    def change(model):
        heavier(model, follows=False)
        body = model.body("fore").id
        own, load, at, centre = model.body_mass[body], 0.25, np.array([0, 0, -0.35]), model.body_ipos[body].copy()
        joint = (own * centre + load * at) / (own + load)
        arm = own * (centre - joint) @ (centre - joint) + load * (at - joint) @ (at - joint)
        model.body_mass[body], model.body_ipos[body] = own + load, joint
        model.body_inertia[body] += arm * np.array([1, 1, 0])  # about the capsule's long axis nothing changes

    found = diagnose_gap(nominal(), record(change, noise=1e-3, seed=5), ParameterSpace([MASS]))
    named = {(e.effect, e.target) for e in found.effects}
    named |= {(r.effect, r.target) for e in found.effects for r in e.indistinguishable}
    assert ("payload", "fore") in named
    assert len(found.effects) == 1
