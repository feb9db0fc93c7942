"""Folders of .npy transitions with an explicit layout of the observations."""

import re
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from nfpde.dataset import load_dropo
from nfpde.errors import BadDataset, BadInput

LAYOUT = {"qpos": [None, 1], "qvel": [2, 0], "control_dt": 0.5}


def arrays(**changes):
    """Two episodes of 2 and 1 transitions; observation [t, t+0.1, t+0.2], the last one not marked as ended."""
    obs = np.array([0, 1, 5])[:, None] + np.array([0, 0.1, 0.2])
    new = np.array([1, 2, 6])[:, None] + np.array([0, 0.1, 0.2])
    return {
        "observations": obs,
        "nextobservations": new,
        "actions": np.array([[7.0], [8.0], [9.0]]),
        "terminals": np.array([False, True, False]),
    } | changes


def write(folder, **changes):
    for kind, array in arrays(**changes).items():
        np.save(folder / f"hopper_{kind}.npy", array)
    return folder


def test_layout_by_hand(tmp_path):
    """Columns land where the layout says, None is 0, the last next observation closes an episode."""
    data = load_dropo(write(tmp_path), **LAYOUT)
    assert data.names == ["0", "1"]
    assert data.control_dt == data.metadata.control_dt == 0.5
    assert_array_equal(data["0"].time, [0, 0.5, 1])
    assert_array_equal(data["0"].qpos, [[0, 0.1], [0, 1.1], [0, 2.1]])
    assert_array_equal(data["0"].qvel, [[0.2, 0], [1.2, 1], [2.2, 2]])
    assert_array_equal(data["0"].ctrl, [[7], [8], [8]])
    assert_array_equal(data["1"].qpos, [[0, 5.1], [0, 6.1]])


def test_layout_of_numpy_integers(tmp_path):
    """Columns out of an array, as np.arange makes them, are as good as plain ones."""
    plain = load_dropo(write(tmp_path), qpos=[1], qvel=[2], control_dt=0.5)
    given = load_dropo(tmp_path, qpos=np.arange(1, 2), qvel=[np.uint8(2)], control_dt=0.5)
    assert given.content_hash() == plain.content_hash()
    refused: tuple[Any, ...] = (np.array([7]), np.array([1.0]), [np.bool_(True)])
    for wrong in refused:
        with pytest.raises(BadInput, match="the layout names column"):
            load_dropo(tmp_path, qpos=[1], qvel=wrong, control_dt=0.5)


def test_unchained_transitions(tmp_path):
    """With chained=False every transition stands alone, and gives the same transitions as the chain."""
    write(tmp_path)
    chained, apart = load_dropo(tmp_path, **LAYOUT), load_dropo(tmp_path, **LAYOUT, chained=False)
    assert len(apart) == 3
    for field in ("state", "ctrl"):
        assert_array_equal(getattr(chained.transitions(), field), getattr(apart.transitions(), field))


def test_terminals_of_other_shapes(tmp_path):
    """A column of 0 and 1 is as good as a row of False and True."""
    a = load_dropo(write(tmp_path), **LAYOUT).content_hash()
    write(tmp_path, terminals=np.array([[0], [1], [0]]))
    assert load_dropo(tmp_path, **LAYOUT).content_hash() == a


BAD = {
    "broken chain": (
        {"nextobservations": arrays()["nextobservations"] + [[0, 0.01, 0]]},
        {},
        "row 0: its next observation is not the observation of row 1, although no episode ends there (1 such",
    ),
    "column range": ({}, {"qpos": [3, 1]}, "the layout names column 3; observations have columns 0 to 2"),
    "negative column": ({}, {"qpos": [-1, 1]}, "the layout names column -1"),
    "column twice": ({}, {"qvel": [1, 0]}, "the layout takes column 1 twice"),
    "step": ({}, {"control_dt": 0.0}, "control_dt is 0.0; it must be a positive number of seconds"),
    "terminals": ({"terminals": np.array([0, 2, 0])}, {}, "terminals, row 1: 2.0 is neither 0 nor 1"),
    "rows": ({"actions": np.zeros((2, 1))}, {}, "the files differ in rows ({'observations': 3, 'nextobservations': 3,"),
    "columns": ({"nextobservations": np.zeros((3, 2))}, {}, "observations have 3 columns and next observations 2"),
    "actions flat": ({"actions": np.zeros(3)}, {}, "hopper_actions.npy has shape (3,); it must have two dimensions"),
    "objects": ({"actions": np.full((3, 1), None)}, {}, "hopper_actions.npy cannot be read"),
    "not finite": ({"actions": np.full((3, 1), np.nan)}, {}, "episode '0', row 0, column ctrl_0: the value is nan"),
    "empty": ({k: a[:0] for k, a in arrays().items()}, {}, "the files hold no transition"),
    "clipped after": ({}, {"velocity_limit": 6.0}, "row 2, observation column 0: a velocity of exactly +-6"),
    "clipped": ({}, {"velocity_limit": 5.0}, "row 2, observation column 0: a velocity of exactly +-5 (1 such row(s))"),
}


@pytest.mark.parametrize("case", BAD)
def test_refusals(case, tmp_path):
    """Each broken folder or layout is refused with the rule."""
    changes, layout, text = BAD[case]
    write(tmp_path, **changes)
    with pytest.raises((BadDataset, BadInput), match=re.escape(text)):
        load_dropo(tmp_path, **(LAYOUT | layout))


def test_clipped_velocities_can_be_allowed(tmp_path):
    """Velocities at the limit are taken when the caller says that there is none."""
    write(tmp_path, **{k: 10 * arrays()[k] for k in ("observations", "nextobservations")})
    with pytest.raises(BadDataset, match="clipped"):
        load_dropo(tmp_path, **LAYOUT)
    assert load_dropo(tmp_path, **LAYOUT, velocity_limit=None)["0"].qvel[1, 1] == 10


def test_missing_and_doubled_files(tmp_path):
    """One file of each kind: neither none nor two."""
    with pytest.raises(BadDataset, match="the folder does not exist"):
        load_dropo(tmp_path / "absent", **LAYOUT)
    write(tmp_path)
    np.save(tmp_path / "walker_actions.npy", np.zeros((3, 1)))
    with pytest.raises(BadDataset, match=r"2 files are named \*_actions\.npy; one is needed"):
        load_dropo(tmp_path, **LAYOUT)
    (tmp_path / "hopper_actions.npy").unlink()
    (tmp_path / "hopper_terminals.npy").unlink()
    with pytest.raises(
        BadDataset, match=r"0 files are named \*_terminals\.npy; one is needed\. The folder holds hopper_"
    ):
        load_dropo(tmp_path, **LAYOUT)
