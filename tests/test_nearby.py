"""Bounds around values of an effect that are known."""

import math

import gymnasium
import numpy as np
import pytest

from nfpde.benchmarks import robot
from nfpde.effects import DataScales, Quantity, all_candidates
from nfpde.errors import BadEffect
from nfpde.nearby import bounds_near, effect_near
from nfpde.sim import load_model
from tests.gap_reports import arm

INF = math.inf
PER_DOF = ("middle", "position", "speed", "acceleration", "force")
PER_CTRL = ("ctrl", "ctrl_spread", "actuator_force", "actuator_peak")


@pytest.mark.parametrize(
    ("quantity", "value", "span", "low", "high"),
    [
        (Quantity("torque", "Nm", 0.0, INF, neutral=0.0), 0.4, 0.01, 0.2, 0.6),  # half of it
        (Quantity("torque", "Nm", 0.0, INF, neutral=0.0), 0.4, 0.5, 0.0, 1.4),  # badly known; none is negative
        (Quantity("scale", "-", 0.0, 10.0, neutral=1.0), 0.8, 0.0, 0.7, 0.9),  # half of the way to 1
        (Quantity("scale", "-", 0.0, 10.0, neutral=1.0), 0.2, 0.0, 0.1, 0.3),  # nearer to 0 than to 1
        (Quantity("scale", "-", 0.0, 10.0, neutral=1.0), 0.0, 0.0, 0.0, 0.5),  # nothing left of it
        (Quantity("limit", "Nm", 0.0, INF, neutral=1e12), 3.0, 0.0, 1.5, 4.5),  # no limit is not a size
        (Quantity("rest", "rad", -INF, INF, neutral=0.1, shape_only=True), -0.2, 0.0, -0.3, -0.1),
        (Quantity("delay", "s", 0.0, 1.0, neutral=0.0), 0.9, 0.0, 0.45, 1.0),
        (Quantity("offset", "rad", -INF, INF, neutral=0.0), 0.0, 0.0, -0.1, 0.1),  # nothing says how much
    ],
)
def test_bounds_by_hand(quantity, value, span, low, high):
    """Half of the way to where the effect vanishes, twice what it is known to, and never beyond physics."""
    name = quantity.name
    assert bounds_near([quantity], {name: value}, {name: span})[name] == pytest.approx((low, high), rel=1e-12)


def test_components_of_a_vector_reach_as_far_as_the_largest():
    """A force along x may be a little askew; a mass says nothing of where it sits."""
    x, y = (Quantity(f"force_{axis}", "N", -INF, INF, neutral=0.0) for axis in "xy")
    assert bounds_near([x, y], {"force_x": 8.0, "force_y": 0.0}) == {"force_x": (4.0, 12.0), "force_y": (-4.0, 4.0)}
    mass, place = (Quantity(*q, -INF, INF, neutral=0.0) for q in (("mass", "kg"), ("position_x", "m")))
    assert bounds_near([mass, place], {"mass": 8.0, "position_x": 0.01})["position_x"] == pytest.approx((0.005, 0.015))


@pytest.mark.parametrize("asset", ["hopper.xml", "reacher.xml"])
def test_every_effect_that_a_diagnosis_tries(asset):
    """Under the name it has in reports, every candidate comes back with bounds that hold its values."""
    model = load_model(f"{gymnasium.__path__[0]}/envs/mujoco/assets/{asset}")
    per_dof, per_ctrl = dict.fromkeys(PER_DOF, np.ones(model.nv)), dict.fromkeys(PER_CTRL, np.ones(model.nu))
    scales = DataScales(control_dt=0.02, length=1.0, **per_dof, **per_ctrl)
    tried = all_candidates(model, scales)
    assert len({e.name for e in tried}) > 20
    for e in tried:
        values = dict(zip([p.field.split(".")[1] for p in e.parameters], e.screened(scales)[-1].tolist(), strict=True))
        again = effect_near(model, e.name, e.place, values)
        assert (again.name, again.target) == (e.name, e.target)
        for p, v in zip(again.parameters, values.values(), strict=True):
            assert p.low <= v <= p.high, p


def test_all_of_one_is_that_one():
    """A pendulum's only motor has its name, as in what a diagnosis finds there; of several they are all meant."""
    assert effect_near(robot("pendulum").model, "actuation_delay", None, {"delay": 0.1}).target == "motor"
    assert effect_near(robot("hopper").model, "actuation_delay", "all", {"delay": 0.1}).target == "*"
    both = effect_near(arm(), "viscous_damping", "shoulder, elbow", {"damping": 0.1})
    assert both.target == ("shoulder", "elbow")  # as a diagnosis calls two of them


@pytest.mark.parametrize(
    ("name", "target", "values", "text"),
    [
        ("glue", "elbow", {"torque": 1.0}, "no effect is called 'glue'; known: actuation_delay"),
        ("coulomb_friction", "wrist", {"torque": 1.0}, "the model has no joint 'wrist'; it has: shoulder, elbow"),
        ("coulomb_friction", "elbow", {"force": 1.0}, "give a value for each of torque; got force"),
        ("coulomb_friction", "elbow", {}, "give a value for each of torque; got none"),
        ("coulomb_friction", "elbow", {"torque": -1.0}, r"torque must be a number within \[0, inf\] Nm, got -1"),
        ("joint_offset", "elbow", {"offset": math.nan}, "offset must be a number"),
        ("joint_offset", "elbow", {"offset": 1.7e308}, "offset must be a number"),
        ("joint_offset", "elbow", {"offset": "1"}, "offset must be a number"),
        ("wind", "elbow", {f"velocity_{axis}": 1.0 for axis in "xyz"}, "takes no target"),
    ],
)
def test_what_is_no_effect(name, target, values, text):
    """Names, targets and values, each with what there is."""
    with pytest.raises(BadEffect, match=text):
        effect_near(arm(), name, target, values)
