"""Calls that are easily written wrong are refused with what to write."""

import re

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadEffect, BadInput, BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator, export_mjcf, make_simulator
from tests.models import DOUBLE_PENDULUM, load, make_windows

MASS = Parameter("body_mass", "lower", 0.3, 1.5)
DAMPED = effect("viscous_damping", "elbow", damping=(0, 2))


@pytest.mark.parametrize(
    ("effects", "text"),
    [
        (
            DAMPED,
            "effects must be a list, got the effect viscous_damping alone; write [effect('viscous_damping', ...)]",
        ),
        (["coulomb_friction"], "effects[0] is no effect, got 'coulomb_friction'; write effect('coulomb_friction', "),
        ([DAMPED, MASS], "effects[1] is no effect, got Parameter("),
        ("coulomb_friction", "effects must be a list of effects, got 'coulomb_friction'"),
        (None, "effects must be a list of effects, got None"),
    ],
)
def test_effects_that_are_none(tmp_path, effects, text):
    """Wherever effects are given."""
    space = ParameterSpace([MASS])
    (tmp_path / "robot.xml").write_text(DOUBLE_PENDULUM)
    for call in (
        lambda: MujocoSimulator(load(DOUBLE_PENDULUM), space, effects),
        lambda: make_simulator(load(DOUBLE_PENDULUM), space, effects, device="cpu"),
        lambda: export_mjcf(tmp_path / "robot.xml", effects, [1.0], tmp_path / "out.xml", space),
    ):
        with pytest.raises(BadEffect, match=re.escape(text)):
            call()


def test_effects_in_any_collection():
    """A tuple, or what makes them one by one."""
    for effects in ((DAMPED,), (e for e in [DAMPED])):
        assert len(MujocoSimulator(load(DOUBLE_PENDULUM), None, effects).space) == 1  # type: ignore[arg-type]


@pytest.mark.parametrize("given", [MASS, "body_mass", 3, None])
def test_spaces_that_are_none(given):
    with pytest.raises(BadParameter, match="a ParameterSpace is made of a list"):
        ParameterSpace(given)
    if given is not None:
        with pytest.raises(BadParameter, match="a ParameterSpace is made of a list"):
            MujocoSimulator(load(DOUBLE_PENDULUM), given)


@pytest.mark.parametrize("xi", [[["a"]], "one", [[0.5], [0.5, 0.6]], [[{}]], [[1j]]])
def test_vectors_that_are_no_numbers(xi):
    sim = MujocoSimulator(load(DOUBLE_PENDULUM), ParameterSpace([MASS]))
    with pytest.raises(BadParameter, match=r"parameter vectors must be numbers in rows of one length, shape \(n, 1\)"):
        sim.predict(xi, make_windows(sim.model, 1, 1))


@pytest.mark.parametrize("nthread", [2.5, -3, True, "4"])
def test_threads_that_are_no_number(nthread):
    with pytest.raises(BadInput, match=f"nthread is {nthread!r}; it must be a whole number, at least 0"):
        MujocoSimulator(load(DOUBLE_PENDULUM), ParameterSpace([MASS]), nthread=nthread)
    assert MujocoSimulator(load(DOUBLE_PENDULUM), ParameterSpace([MASS]), nthread=np.int64(2)).nthread == 2  # type: ignore[arg-type]
