"""Rows of the model's fields as multiples of the parameters: the numbers that are written field by field."""

import numpy as np
import pytest

from nfpde.benchmarks import ROBOTS
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.warp_linear import LinearRows
from tests.device import WARP
from tests.models import DOUBLE_PENDULUM, load


@pytest.mark.parametrize("name", ROBOTS)
def test_the_robots_are_linear(name):
    """Every bit of every row, at bounds too: masses with their inertias, dampings, frictions, gears."""
    robot = ROBOTS[name]
    model = WarpSimulator(robot.model, robot.space, device=WARP, check_influence=False)._model
    assert model._linear is not None
    xi = np.vstack([robot.space.uniform(200, np.random.default_rng(1)), robot.space.low, robot.space.high])
    written = model.writer.written_rows(xi)
    rows = model.stage(xi, model.narrow, derive=True)
    for field, columns in model.narrow.columns.items():
        if field in written:
            np.testing.assert_array_equal(rows[:, columns], written[field].reshape(len(xi), -1).astype(np.float32))
    again = model.stage(xi, model.narrow, derive=True)
    again[:] = 0
    np.testing.assert_array_equal(model.stage(xi, model.narrow, derive=True), rows)


@pytest.mark.parametrize(
    "rows",
    [
        lambda xi: np.column_stack([xi[:, 0] ** 2, xi[:, 1]]),
        lambda xi: np.column_stack([xi[:, 0] * xi[:, 1], xi[:, 1]]),
        lambda xi: np.column_stack([1 + xi[:, 0], xi[:, 1]]),
        lambda xi: np.column_stack([np.floor(xi[:, 0]), xi[:, 1]]),
        lambda xi: np.column_stack([xi[:, 0], np.where(xi[:, 1] > 2.5, 0.0, 5.0)]),
    ],
)
def test_what_is_no_multiple_is_written_as_before(rows):
    """Squares, products of two, sums, steps, and a constant that is none everywhere."""
    assert LinearRows.of(rows, np.array([0.5, 1.0]), np.array([2.0, 3.0])) is None


def test_multiples_and_constants():
    """A row of two multiples of one parameter, one of the other, and a constant."""

    def rows(xi):
        return np.column_stack([2 * xi[:, 0], np.full(len(xi), 7.0), -0.1 * xi[:, 0], xi[:, 1]])

    found = LinearRows.of(rows, np.array([0.0, -3.0]), np.array([2.0, 3.0]))
    assert found is not None
    xi = np.random.default_rng(2).uniform([0, -3], [2, 3], (50, 2))
    np.testing.assert_array_equal(found(xi), rows(xi).astype(np.float32))


def test_a_ratio_of_impedances_is_none():
    """MuJoCo Warp holds another number than the parameter: it is written as before."""
    ratio = ParameterSpace([Parameter("opt.impratio", None, 1.0, 10.0)])
    assert WarpSimulator(load(DOUBLE_PENDULUM), ratio, device=WARP, check_influence=False)._model._linear is None
