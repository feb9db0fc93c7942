"""Checks of a data set against a model given as numbers and names."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfpde.dataset import ColumnNames, Dataset, Episode, check_against_model, expand_names
from nfpde.errors import BadDataset

NAMES = {"qpos": ["base", "elbow"], "qvel": ["base", "elbow"], "ctrl": ["m"]}


def data(dt=0.02, names=None):
    n = 4
    qpos = np.column_stack([np.arange(n), 10.0 + np.arange(n)])
    return Dataset(
        [Episode("a", dt * np.arange(n), qpos, 100 + qpos, np.zeros((n, 1)))],
        column_names=ColumnNames() if names is None else names,
        source="log.csv",
    )


def fit(dataset, **changes):
    model = {"nq": 2, "nv": 2, "nu": 1, "timestep": 0.002, "names": NAMES} | changes
    return check_against_model(dataset, **model)


def attitudes(*lengths):
    """A free body whose unit quaternions have the given lengths instead."""
    n = len(lengths)
    q = np.array([0.5, -0.5, 0.5, -0.5]) * np.array(lengths)[:, None]
    return Dataset([Episode("a", np.arange(n), np.hstack([np.ones((n, 3)), q]), np.zeros((n, 6)), np.zeros((n, 0)))])


def test_a_fitting_dataset_is_returned_as_it_is():
    """Where nothing has to change the very same object comes back."""
    numbered, named = data(), data(names=ColumnNames(("base", "elbow"), ("base", "elbow"), ("m",)))
    assert fit(numbered) is numbered
    assert fit(named) is named
    assert fit(numbered, names=None) is numbered


def test_columns_are_put_in_the_models_order_by_name():
    """Each named group is reordered by itself; numbered ones stay."""
    swapped = fit(data(names=ColumnNames(qpos=("elbow", "base"))))
    assert_array_equal(swapped[0].qpos, data()[0].qpos[:, ::-1])
    assert_array_equal(swapped[0].qvel, data()[0].qvel)
    assert swapped.column_names == ColumnNames(qpos=("base", "elbow"))
    assert swapped.source == "log.csv"


def test_reordering_three_columns():
    """A cycle of three goes the right way round (a swap could not tell)."""
    qpos = np.array([[1.0, 2, 3]] * 2)
    episode = Episode("a", [0, 1], qpos, qpos, np.zeros((2, 0)))
    cycled = Dataset([episode], column_names=ColumnNames(qpos=("c", "a", "b")))
    names = {"qpos": ["a", "b", "c"]}
    assert_array_equal(check_against_model(cycled, nq=3, nv=3, nu=0, timestep=1, names=names)[0].qpos, [[2, 3, 1]] * 2)


@pytest.mark.parametrize(
    ("dataset", "changes", "text"),
    [
        (
            data(),
            {"nu": 3, "names": {"ctrl": ["x", "y", "z"]}},
            "the data has 1 ctrl column(s) and the model has 3 (x, y, z); data: nq=2, nv=2, nu=1, model: nq=2",
        ),
        (
            data(names=ColumnNames(qvel=("base", "wrist"))),
            {},
            "column(s) wrist that the model does not have, and lacks elbow; the model has base, elbow",
        ),
        (
            data(names=ColumnNames(ctrl=("m",))),
            {"names": {}},
            "the model has no names. Rename the columns, or number them ctrl_0, ctrl_1",
        ),
        (
            data(dt=0.0201),
            {},
            "0.0201 s, is no multiple of the model's timestep, 0.002 s; the nearest multiple(s): 0.02 s and 0.022 s",
        ),
        (data(dt=0.001), {}, "the nearest multiple(s): 0.002 s. Resample"),
        (data(dt=0.003), {}, "or set the model's timestep to 0.003 s"),
        (
            attitudes(1, 1.0011, 1),
            {"nq": 7, "nv": 6, "nu": 0, "timestep": 1, "quaternions": [3]},
            "row 1, columns qpos_3 to qpos_6: the quaternion has length 1.0011; it must be 1 within 0.001",
        ),
    ],
)
def test_refusals(dataset, changes, text):
    """What does not fit is refused with what the model has."""
    with pytest.raises(BadDataset, match=re.escape(text)):
        fit(dataset, **changes)


@pytest.mark.parametrize("dt", [0.002, 0.02, 0.0200001, 0.3])
def test_multiples_within_rounding_are_accepted(dt):
    """One, ten and many timesteps, also with a clock that is off by 5 parts in a million."""
    assert fit(data(dt=dt)).control_dt == pytest.approx(dt, rel=1e-11)


def test_rounded_quaternions_are_scaled_and_exact_ones_kept():
    """Lengths off by 5e-4 become 1 in the same direction; lengths off by 1e-7 keep every bit."""
    dataset = attitudes(1.0005, 1 + 1e-7)
    fitted = check_against_model(dataset, nq=7, nv=6, nu=0, timestep=1, quaternions=[3])
    assert_allclose(fitted[0].qpos[0, 3:], [0.5, -0.5, 0.5, -0.5], rtol=1e-15)
    assert_array_equal(fitted[0].qpos[1], dataset[0].qpos[1])
    assert_array_equal(fitted[0].qpos[:, :3], 1)


def test_names_of_elements_with_several_columns():
    """Free and ball joints get one indexed name a column."""
    assert expand_names(["root", "hinge"], [7, 1]) == [*(f"root[{i}]" for i in range(7)), "hinge"]
