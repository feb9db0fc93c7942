"""Parameters, their box, and the map to R^D."""

import json
import math
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nfpde.errors import BadParameter, SpaceMismatch
from nfpde.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace(
    [
        Parameter("body_mass", "torso", 2.0, 6.0),
        Parameter("dof_damping", ("hip", "knee"), 1e-6, 1e-3),
        Parameter("opt.gravity", None, -10.5, -9.0, component=2),
    ]
)
Z = st.floats(-700, 700)


def test_the_map_is_the_sigmoid_box():
    """It is xi = low + (high - low) / (1 + exp(-z)), evaluated naively where that is exact enough."""
    z = np.linspace(-20, 20, 101)[:, None] * np.ones(3)
    naive = SPACE.low + (SPACE.high - SPACE.low) / (1 + np.exp(-z))
    np.testing.assert_allclose(SPACE.to_physical(z), naive, rtol=1e-14)


@given(st.lists(Z, min_size=3, max_size=3))
def test_the_map_never_leaves_the_box(z):
    """Whatever z, rounding included, xi passes the space's own check."""
    SPACE.check(SPACE.to_physical(z))


def test_infinite_z_is_the_bound():
    """The limits of the map are the bounds, exactly, and back."""
    ends = np.array([[-np.inf] * 3, [np.inf] * 3])
    np.testing.assert_array_equal(SPACE.to_physical(ends), [SPACE.low, SPACE.high])
    np.testing.assert_array_equal(SPACE.to_unconstrained([SPACE.low, SPACE.high]), ends)


@given(st.lists(st.floats(-15, 15), min_size=3, max_size=3))
def test_inverse(z):
    """to_unconstrained undoes to_physical; near a bound as well as rounding of xi allows (exp(15) ulps)."""
    np.testing.assert_allclose(SPACE.to_unconstrained(SPACE.to_physical(z)), z, rtol=1e-6, atol=1e-8)


@given(st.lists(st.floats(-8, 8), min_size=3, max_size=3))
def test_log_det_jacobian_is_the_derivative(z):
    """Against central differences of the map, with a step that leaves nine digits."""
    z, step = np.array(z), 1e-5
    slope = (SPACE.to_physical(z + step) - SPACE.to_physical(z - step)) / (2 * step)
    assert SPACE.log_det_jacobian(z) == pytest.approx(np.log(slope).sum(), abs=1e-4)


def test_log_det_jacobian_far_out():
    """Log sigmoid'(z) -> -|z| for large |z|: finite where a naive formula takes log(0)."""
    space = ParameterSpace([Parameter("x", low=0.0, high=2.0)])
    np.testing.assert_allclose(space.log_det_jacobian([[900.0], [-900.0]]), np.log(2) - 900, rtol=1e-15)


def test_shapes():
    """Any leading shape goes through; the Jacobian sums over the last axis."""
    z = np.zeros((4, 5, 3))
    assert SPACE.to_physical(z).shape == SPACE.to_unconstrained(SPACE.to_physical(z)).shape == (4, 5, 3)
    assert SPACE.log_det_jacobian(z).shape == (4, 5)


def test_uniform_fills_the_box():
    """Mean and variance of a uniform variable, each within five standard errors of n = 20000 draws."""
    x = SPACE.uniform(20000, np.random.default_rng(0))
    unit = (SPACE.check(x) - SPACE.low) / SPACE.width
    assert np.abs(unit.mean(0) - 1 / 2).max() < 5 * math.sqrt(1 / 12 / 20000)
    assert np.abs(unit.var(0) - 1 / 12).max() < 5 * math.sqrt(1 / 180 / 20000)


def test_names_and_units():
    """Names say field, target and component; units are the field's, and unknown for a ratio."""
    assert SPACE.names == ["body_mass:torso", "dof_damping:hip+knee", "opt.gravity[2]"]
    assert SPACE.units == ["kg", "Nm s/rad", "m/s²"]
    assert Parameter("body_mass", 3, 0.5, 2.0, relative=True).unit == ""
    assert Parameter("geom_friction", "*", 0.5, 2.0, name="floor", unit="-").name == "floor"
    assert Parameter("x", ["a", 1], 0, 1).target == ("a", 1)  # type: ignore[arg-type]
    assert type(Parameter("x", np.int64(3), 0, 1).target) is int  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"low": 1.0}, "high is inf; both bounds must be given and finite"),
        ({"low": math.nan, "high": 1.0}, "low is nan"),
        ({"low": 2.0, "high": 2.0}, r"low \(2\) must be below high \(2\); to fix a value, set it in the model"),
        ({"low": 3.0, "high": 2.0}, r"low \(3\) must be below high \(2\)"),
        ({"low": "0", "high": 1.0}, "low must be a number, got '0'"),
        ({"low": True, "high": 2.0}, "low must be a number, got True"),
        ({"low": 0.0, "high": 1.0, "component": -1}, "component must be an integer >= 0, got -1"),
        ({"low": 0.0, "high": 1.0, "component": 0.5}, "component must be an integer >= 0, got 0.5"),
        ({"low": 0.0, "high": 1.0, "target": ()}, "field and target may not be empty"),
        ({"low": 0.0, "high": 1.0, "target": ""}, "field and target may not be empty"),
        ({"low": 0.0, "high": 1.0, "field": ""}, "field and target may not be empty"),
        ({"low": 0.0, "high": 1.0, "field": 5}, "parameter 5:torso: field must be a text, got 5"),
        ({"low": 0.0, "high": 1.0, "name": 3}, "parameter body_mass:torso: name must be a text, got 3"),
        ({"low": 0.0, "high": 1.0, "unit": 5}, "parameter body_mass:torso: unit must be a text, got 5"),
        ({"low": 0.0, "high": 1.0, "relative": "yes"}, "relative must be true or false, got 'yes'"),
        ({"low": 0.0, "high": 1.0, "scale_inertia": 1}, "scale_inertia must be true or false, got 1"),
        ({"low": 0.0, "high": 1.0, "target": 1.5}, r"target must be a name, an id .* or a list of them, got 1.5"),
        ({"low": 0.0, "high": 1.0, "target": ["a", True]}, r"target must be a name.* got \('a', True\)"),
        ({"low": 0.0, "high": 10**400}, "high is an integer beyond float64; both bounds must be given and finite"),
        ({"low": -1e308, "high": 1e308}, r"high - low is inf for the bounds -1e\+308 and 1e\+308; it must lie between"),
        ({"low": 0.0, "high": 5e-324}, "high - low is 4.94066e-324 for .* between 2.2e-308 and 1.8e.308, the range of"),
    ],
)
def test_a_bad_parameter_is_refused(arguments, text):
    """Each rule has its own text, which names the parameter."""
    with pytest.raises(BadParameter, match=text):
        Parameter(**({"field": "body_mass", "target": "torso"} | arguments))


def test_a_bad_space_is_refused():
    """Nothing to estimate, something that is no parameter, one name for two."""
    p = Parameter("body_mass", "torso", 1.0, 2.0)
    with pytest.raises(BadParameter, match="at least one Parameter"):
        ParameterSpace([])
    with pytest.raises(BadParameter, match="made of Parameter objects, got str: 'mass'"):
        ParameterSpace([p, "mass"])  # type: ignore[list-item]
    with pytest.raises(BadParameter, match="used more than once: body_mass:torso"):
        ParameterSpace([p, Parameter("body_mass", "torso", 1.0, 3.0)])


def test_check_names_the_first_offender():
    """Row, name, value, bounds, and how many rows are concerned."""
    xi = np.tile((SPACE.low + SPACE.high) / 2, (5, 1))
    np.testing.assert_array_equal(SPACE.check(xi[0]), xi[:1])
    np.testing.assert_array_equal(SPACE.check([SPACE.low, SPACE.high]), [SPACE.low, SPACE.high])
    xi[3, 0], xi[4, 2] = 6.5, np.nan
    with pytest.raises(BadParameter, match=r"row 3: body_mass:torso = 6.5 lies outside \[2, 6\] \(2 of 5 rows"):
        SPACE.check(xi)
    with pytest.raises(BadParameter, match=r"shape \(n, 3\), got \(5, 2\)"):
        SPACE.check(xi[:, :2])
    with pytest.raises(BadParameter, match=r"shape \(n, 3\), got \(1, 5, 3\)"):
        SPACE.check(xi[None])


def awkward_space():
    return ParameterSpace(
        [
            *SPACE,
            Parameter("body_mass", "foot", 0.5, 2.0, relative=True, scale_inertia=False),
            Parameter("geom_friction", ("#3", 4), 0.1, 1e22, component=1, unit="µ", name='say "hi"\\\n\t\x7f€'),
            Parameter("body_ipos", 2, -1e-300, 5e-324, component=2),
        ]
    )


def test_json_round_trip():
    """Through text and back, every field of every parameter is the same."""
    space = awkward_space()
    again = ParameterSpace.from_json(json.loads(json.dumps(space.to_json())))
    assert again == space
    space.check_same(again)
    assert hash(again) == hash(space)


def test_toml_round_trip(tmp_path):
    """The written file is TOML for any reader, gives the same space, and says nothing that is automatic."""
    space = awkward_space()
    space.to_toml(tmp_path / "p.toml")
    assert ParameterSpace.from_toml(tmp_path / "p.toml") == space
    first = tomllib.loads((tmp_path / "p.toml").read_bytes().decode())["parameter"][0]
    assert first == {"field": "body_mass", "target": "torso", "low": 2.0, "high": 6.0}


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("[[parameter]\n", "not valid TOML"),
        ("", r"expected \[\[parameter\]\] tables and nothing else, found: nothing"),
        ("x = 1\n[[parameter]]\nfield='a'\nlow=0\nhigh=1", r"found: \['parameter', 'x'\]"),
        ("parameter = 3", r"expected \[\[parameter\]\] tables"),
        ("parameter = [3]", "parameter 0: expected a table, got 3"),
        ("[[parameter]]\nfield='a'\nlow=0\nhigh=1\nnominal=2", "parameter 0: unknown key 'nominal'; known: component"),
        ("[[parameter]]\nfield='a'\nlow=0", "parameter 0: high missing"),
        ("[[parameter]]\nfield=5\nlow=0\nhigh=1", "parameter 0: parameter 5: field must be a text, got 5"),
        ("[[parameter]]\nfield='a'\nlow=0\nhigh=1\nname=3", "parameter 0: .*: name must be a text, got 3"),
        ("[[parameter]]\nfield='a'\nlow=0\nhigh=1\nrelative='yes'", "parameter 0: .*relative must be true or false"),
        ("[[parameter]]\nfield='a'\nlow=0\nhigh=1\ntarget={b=1}", "parameter 0: .*target must be a name"),
        ("[[parameter]]\nfield='a'\nlow=0\nhigh=1\n[[parameter]]\nfield='b'\nlow=1\nhigh=0", "parameter 1: .*'b': low"),
    ],
)
def test_bad_files_are_refused(tmp_path, content, text):
    """The message names the file, the number of the table and the rule."""
    path = tmp_path / "p.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(BadParameter, match=r"p\.toml.*" + text):
        ParameterSpace.from_toml(path)


def test_unreadable_files_are_refused(tmp_path):
    """A missing file and bytes that are no text."""
    with pytest.raises(BadParameter, match=r"none\.toml: cannot be read"):
        ParameterSpace.from_toml(tmp_path / "none.toml")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(BadParameter, match=r"b\.toml: not valid TOML"):
        ParameterSpace.from_toml(tmp_path / "b.toml")
    with pytest.raises(BadParameter, match=r"state\.json: expected an object with a list"):
        ParameterSpace.from_json([], source="state.json")  # type: ignore[arg-type]


def test_different_spaces_are_told_apart():
    """The first difference is named, with both values."""
    other = ParameterSpace([Parameter("body_mass", "torso", 2.0, 7.0), *list(SPACE)[1:]])
    assert other != SPACE
    with pytest.raises(SpaceMismatch, match=r"parameter 0 \(body_mass:torso\): high is 6.0 here and 7.0 there"):
        SPACE.check_same(other)
    with pytest.raises(SpaceMismatch, match="3 parameters against 4"):
        SPACE.check_same(SPACE + ParameterSpace([Parameter("x", low=0, high=1)]))
