"""Bounds that no robot can have: which are refused, which are let through, and what the message says."""

import re

import numpy as np
import pytest
from scipy.optimize import linprog

from nfpde.errors import BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import ModelWriter, MujocoSimulator, load_model
from tests.models import DOUBLE_PENDULUM, FREE_BOX, PENDULUM, load, make_windows

ARM, ROD, BOX = (load_model(load(xml)) for xml in (DOUBLE_PENDULUM, PENDULUM, FREE_BOX))

TENDON = DOUBLE_PENDULUM.replace(
    "<actuator>", '<tendon><fixed name="belt"><joint joint="shoulder" coef="1"/></fixed></tendon><actuator>'
)


def writer(model, *parameters):
    return ModelWriter(model, ParameterSpace(parameters))


@pytest.mark.parametrize(
    ("xml", "parameter"),
    [
        (DOUBLE_PENDULUM, Parameter("body_mass", "lower", -0.1, 1.0)),
        (DOUBLE_PENDULUM, Parameter("body_mass", "lower", -0.1, 1.0, scale_inertia=False)),
        (DOUBLE_PENDULUM, Parameter("body_mass", "*", -0.1, 1.0, scale_inertia=False)),
        (DOUBLE_PENDULUM, Parameter("body_inertia", "lower", -0.1, 1.0, component=1)),
        (DOUBLE_PENDULUM, Parameter("dof_armature", "elbow", -0.1, 1.0)),
        (DOUBLE_PENDULUM, Parameter("dof_damping", "elbow", -0.1, 1.0)),
        (DOUBLE_PENDULUM, Parameter("dof_frictionloss", "elbow", -0.1, 1.0)),
        (DOUBLE_PENDULUM, Parameter("geom_friction", "upper_arm", -0.1, 1.0, component=2)),
        (DOUBLE_PENDULUM, Parameter("geom_size", "upper_arm", -0.1, 1.0)),
        (DOUBLE_PENDULUM, Parameter("actuator_armature", "shoulder", -0.1, 1.0)),
        (DOUBLE_PENDULUM, Parameter("actuator_damping", "shoulder", -0.1, 1.0)),
        (TENDON, Parameter("tendon_armature", "belt", -0.1, 1.0)),
        (TENDON, Parameter("tendon_damping", "belt", -0.1, 1.0)),
        (TENDON, Parameter("tendon_frictionloss", "belt", -0.1, 1.0)),
        (DOUBLE_PENDULUM, Parameter("opt.density", None, -0.1, 1.0)),
        (DOUBLE_PENDULUM, Parameter("opt.viscosity", None, -0.1, 1.0)),
    ],
    ids=lambda value: value.name if isinstance(value, Parameter) else "",
)
def test_what_cannot_be_negative_is_refused(xml, parameter):
    """The message names the parameter, its bounds, the number, the rule and the way out; from 0 on it is accepted."""
    text = rf"{parameter.field}.*: within its bounds \(-0.1, 1\) {parameter.field} falls to -0.1"
    with pytest.raises(BadParameter, match=f"^{text}.*; it cannot be negative: choose bounds that keep it at 0 or abo"):
        writer(load(xml), parameter)
    with pytest.raises(BadParameter, match="it cannot be negative"):
        MujocoSimulator(load(xml), ParameterSpace([parameter]), check_influence=False)
    low = 0.001 if parameter.field.startswith("body") else 0.0
    same = {k: getattr(parameter, k) for k in ("field", "target", "component", "scale_inertia")}
    if parameter.target == "*":
        same["target"] = ("upper", "lower")  # the world has no mass to give
    writer(load(xml), Parameter(**same, low=low, high=0.2))


def test_ratios_count_by_the_number_they_write():
    """A ratio below 0 makes the model's damping 0.1 negative; the unit stands in the message."""
    with pytest.raises(BadParameter, match=r"within its bounds \(-2, 3\) dof_damping falls to -0.2 Nm s/rad;"):
        writer(ARM, Parameter("dof_damping", "elbow", -2.0, 3.0, relative=True))
    negative = load(DOUBLE_PENDULUM.replace('damping="0.1"', 'damping="-0.1"'))
    with pytest.raises(BadParameter, match=r"dof_damping falls to -0.3 Nm s/rad;"):
        writer(negative, Parameter("dof_damping", "elbow", 2.0, 3.0, relative=True))


@pytest.mark.parametrize(
    "parameter",
    [
        Parameter("jnt_stiffness", "elbow", -5.0, 5.0),
        Parameter("actuator_gear", "shoulder", -1.0, 1.0),
        Parameter("actuator_gainprm", "shoulder", -1.0, 1.0),
        Parameter("body_gravcomp", "lower", -0.5, 0.5),
        Parameter("body_ipos", "lower", -0.1, 0.1, component=2),
    ],
    ids=lambda p: p.field,
)
def test_signs_that_exist_are_accepted(parameter):
    """Springs that push over, motors wired backwards, weights that are pulled down."""
    assert parameter.field in writer(ARM, parameter).fields


@pytest.mark.parametrize(
    ("model", "parameters", "joint"),
    [
        (ARM, [Parameter("body_mass", "lower", 0.0, 1.0), Parameter("dof_armature", "elbow", 0.0, 0.1)], "elbow"),
        (ROD, [Parameter("body_mass", "rod", 0.0, 1.0)], "hinge"),
        (ROD, [Parameter("body_mass", "rod", 0.0, 2.0, relative=True)], "hinge"),
        (BOX, [Parameter("body_mass", "box", 0.0, 1.0, scale_inertia=False)], "root"),
        (
            load_model(load(PENDULUM.replace('pos="0 0 -0.5" mass', 'pos="0 0 0" mass'))),
            [Parameter("body_inertia", "rod", 0.0, 0.05, component=1)],
            "hinge",
        ),
    ],
    ids=["two parameters", "mass", "ratio", "free body", "inertia"],
)
def test_nothing_left_to_accelerate(model, parameters, joint, capfd):
    """A mass matrix that is singular at the lower bounds is refused by its joint, without MuJoCo's own warning."""
    names = re.escape(", ".join(p.name for p in parameters))
    text = f"^{names}: with all parameters at their lower bounds joint '{joint}' moves something"
    with pytest.raises(BadParameter, match=text + r".*; raise a lower bound above 0 or give the joint an armature"):
        writer(model, *parameters)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("model", "parameter"),
    [
        (ARM, Parameter("body_mass", "upper", 0.0, 1.0)),  # it carries the lower arm
        (ARM, Parameter("body_mass", "lower", 0.0, 1.0)),  # the joint has an armature
        (ROD, Parameter("body_mass", "rod", 0.0, 1.0, scale_inertia=False)),  # its inertia stays
        (ROD, Parameter("body_inertia", "rod", 0.0, 0.05, component=1)),  # its mass is off the axis
    ],
    ids=["carries another", "armature", "inertia", "mass"],
)
def test_zero_is_accepted_where_something_else_is_moved(model, parameter):
    """MuJoCo simulates it: finite numbers at the lower bound itself."""
    sim = MujocoSimulator(model, ParameterSpace([parameter]), check_influence=False)
    assert np.isfinite(sim.predict([[0.0]], make_windows(sim.model, 3, 10))).all()


@pytest.mark.parametrize(
    ("bounds", "text"),
    [
        (
            [None, (0.06, 1.0), None],
            r"^body_inertia:rod\[1\]: of a body's three .* number 1 of body 'rod' is at least 0.06 kg m² and the "
            r"others at most 0.05 together; lower the bounds of that one or raise the others'",
        ),
        ([None, (0.01, 0.029), None], "number 0 of body 'rod' is at least 0.04 kg m² and the others at most 0.039 tog"),
        (
            [(0.1, 0.2), (0.1, 0.2), (0.5, 0.6)],
            "number 2 of body 'rod' is at least 0.5 kg m² and the others at most 0.4",
        ),
    ],
)
def test_inertias_that_no_body_has(bounds, text):
    """The rod has 0.04, 0.05 and 0.01 kg m²; the compiler refuses the nearest corner as well."""
    parameters = [Parameter("body_inertia", "rod", *b, component=i) for i, b in enumerate(bounds) if b]
    with pytest.raises(BadParameter, match=text):
        writer(ROD, *parameters)
    own = (0.04, 0.05, 0.01)
    for corner in np.ndindex(2, 2, 2):
        moments = [own[i] if b is None else b[c] for i, (b, c) in enumerate(zip(bounds, corner, strict=True))]
        with pytest.raises(ValueError, match="inertia must satisfy"):
            load(PENDULUM.replace("0.04 0.05 0.01", " ".join(map(str, moments))))


def test_an_inertia_box_is_refused_only_where_no_point_of_it_is_possible():
    """Random boxes, against a linear programme that looks for a point with A <= B + C in all three orders."""
    rng = np.random.default_rng(0)
    rule = 2 * np.eye(3) - 1
    outcomes = []
    for _ in range(60):
        low, high = np.sort(rng.uniform(0.01, 1.0, (2, 3)) ** 6, axis=0)
        space = [Parameter("body_inertia", "box", low[i], high[i], component=i) for i in range(3)]
        possible = linprog(np.zeros(3), rule, np.zeros(3), bounds=np.stack([low, high], 1)).status == 0
        outcomes.append(possible)
        if possible:
            writer(BOX, *space)
        else:
            with pytest.raises(BadParameter, match="none exceeds the sum of the other two"):
                writer(BOX, *space)
    assert 5 < outcomes.count(False) < 55


def test_flat_bodies_are_possible():
    """A disc has one moment equal to the sum of the others; bounds that end there are accepted."""
    disc = load(FREE_BOX.replace("0.01 0.02 0.025", "0.1 0.1 0.2"))
    for component, bounds in ((2, (0.2, 0.3)), (0, (0.05, 0.1))):
        assert writer(disc, Parameter("body_inertia", "box", *bounds, component=component)).nbase == 1
