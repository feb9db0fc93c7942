"""Which fitted values lean on the end of what any robot has: not those that say that nothing is there."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.values import fitted_values


def leaning(name, target, bounds, values):
    """Names of the values of an effect that lean on a bound."""
    one = effect(name, target, **bounds)
    fit: Any = SimpleNamespace(xi=np.array(values), replay=SimpleNamespace(parameters=list(one.parameters)))
    names = [q.name for q in one.quantities]
    found = fitted_values(fit, np.full(len(values), 0.01), slice(0, len(values)), names, one.quantities)
    return [n for n, v in found.items() if v.at_bound]


@pytest.mark.parametrize(
    ("name", "target", "bounds", "values", "leans"),
    [
        ("fluid_drag", None, {"density": (0, 398.0), "viscosity": (0, 65.0)}, (0.0, 8.0), []),
        ("fluid_drag", None, {"density": (0, 398.0), "viscosity": (0, 65.0)}, (398.0, 8.0), ["density"]),
        ("load_friction", "elbow", {"base": (0, 8.0), "share": (0, 0.9)}, (0.3, 0.0), []),
        ("load_friction", "elbow", {"base": (0, 8.0), "share": (0, 0.9)}, (0.3, 0.9), ["share"]),
        ("motor_strength", "lift", {"scale": (0.3, 1.0)}, (1.0,), []),
        ("motor_strength", "lift", {"scale": (0.3, 1.0)}, (0.3,), ["scale"]),
        (
            "stribeck_friction",
            "elbow",
            {"coulomb": (0, 8.0), "static": (0, 8.0), "speed": (0.01, 1.9)},
            (0.3, 0.4, 0.01),
            [],
        ),
    ],
)
def test_a_value_leans_where_it_does_something(name, target, bounds, values, leans):
    """Not at the bound where a quantity does nothing, nor where it only shapes what others do."""
    assert leaning(name, target, bounds, values) == leans


def test_parameters_of_the_model_lean_on_either_end():
    """They have no value at which they do nothing; an interval ends at the bounds."""
    one = effect("fluid_drag", density=(0, 10.0), viscosity=(0, 10.0))
    fit: Any = SimpleNamespace(xi=np.array([0.0, 9.0]), replay=SimpleNamespace(parameters=list(one.parameters)))
    found = fitted_values(fit, np.array([1.0, 1.0]), slice(0, 2), ["a", "b"])
    assert (found["a"].at_bound, found["b"].at_bound) == (True, False)
    assert (found["a"].low, found["b"].high) == (0.0, 10.0)
