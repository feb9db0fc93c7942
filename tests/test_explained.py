"""From a diagnosis to the parameters of the next fit."""

from dataclasses import replace

import pytest

from nfpde import MujocoSimulator, ParameterSpace, explained_space
from nfpde.effects import effects_in
from nfpde.errors import BadEffect, BadInput
from nfpde.gap import Fitted
from nfpde.parameters import Parameter
from tests.gap_reports import arm, cause, gap_report

MASSES = ParameterSpace(
    [
        Parameter("body_mass", "upper", 0.5, 3.0),
        Parameter("body_mass", ("lower",), 0.5, 3.0),
        Parameter("body_mass", "upper", 0.5, 2.0, relative=True, scale_inertia=False, name="again"),
        Parameter("dof_damping", "elbow", 0.0, 1.0),
    ]
)


def report(*effects, base=None, verdict="effects"):
    """An answer about an arm of two links."""
    return replace(gap_report(arm(), verdict), effects=list(effects), base=base or {})


def test_effects_stand_behind_the_free_parameters(tmp_path):
    """With bounds around their values, under names that a simulator and a file know."""
    friction = cause("coulomb_friction", "elbow", 0.9, value=0.4)
    space = explained_space(report(friction), MASSES)
    assert space.names == [*MASSES.names, "coulomb_friction.torque:elbow"]
    assert space.parameters[:4] == MASSES.parameters
    assert (space[4].low, space[4].high) == pytest.approx((0.2, 0.6))
    space.to_toml(tmp_path / "explained.toml")
    assert ParameterSpace.from_toml(tmp_path / "explained.toml") == space
    simulator = MujocoSimulator(arm(), ParameterSpace([space[3], space[4]]))
    assert [e.name for e in simulator.effects] == ["coulomb_friction"]


def test_the_reading_that_fits_is_taken():
    """Reports call all readings by the effect's name; a fit needs the one that was found."""
    offset = cause("joint_offset", "elbow", 0.9, "offset", 0.1, "rad", reading="joint_offset_logged")
    (found,) = effects_in(explained_space(report(offset)))
    assert (found.name, found.target) == ("joint_offset_logged", "elbow")


def test_what_stands_for_the_whole_is_no_element():
    """Places in reports are words: all actuators, the world."""
    tilt = cause("gravity_tilt", "world", 0.5, "roll", 0.1, "rad")
    tilt = replace(tilt, parameters={**tilt.parameters, "pitch": Fitted(0.0, -0.01, 0.01, "rad")})
    lag = cause("observation_delay", "all", 0.4, "delay", 0.02, "s")
    space = explained_space(report(tilt, lag))
    assert space.names == ["gravity_tilt.roll", "gravity_tilt.pitch", "observation_delay.delay"]
    assert (space[1].low, space[1].high) == pytest.approx((-0.02, 0.02))  # none, known to 0.01


@pytest.mark.parametrize(
    ("low", "high", "scales"), [(0.0, 0.2, False), (0.0, 1.0, True), (0.8, 1.0, True), (0.3, 0.6, True)]
)
def test_masses_whose_inertia_does_not_follow(low, high, scales):
    """Only where the recordings say so; a mass that nobody asked about stays as it is."""
    base = {"inertia.follows_mass:lower": Fitted((low + high) / 2, low, high, "-")}
    space = explained_space(report(base=base), MASSES)
    assert [p.scale_inertia for p in space] == [True, scales, False, True]


def test_the_space_is_that_of_the_diagnosis():
    """Free parameters are not left out because they were forgotten."""
    base = {p.name: Fitted(1.0, 0.9, 1.1, "kg") for p in MASSES}
    with pytest.raises(BadInput, match="free parameters that the space lacks: body_mass:upper, body_mass:lower, again"):
        explained_space(report(cause("coulomb_friction", "elbow", 0.9), base=base))


def test_nothing_to_fit_is_an_error():
    """A gap that stays unexplained, no parameter at all, and an effect that nobody knows here."""
    friction = cause("coulomb_friction", "elbow", 0.9)
    with pytest.raises(BadInput, match="leaves a gap that no known effect explains"):
        explained_space(report(friction, verdict="unexplained"), MASSES)
    with pytest.raises(BadInput, match="found no effect, and no parameter was free"):
        explained_space(report(verdict="no_gap"))
    with pytest.raises(BadEffect, match="no effect is called 'glue'"):
        explained_space(report(cause("glue", "elbow", 0.9)), MASSES)
