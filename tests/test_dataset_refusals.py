"""Refused episodes, data sets, windows and arguments, read by the text of the refusal."""

import re

import numpy as np
import pytest

from nfpde.dataset import ColumnNames, Dataset, Episode, Metadata, Windows, resample_episode
from nfpde.errors import BadDataset, BadInput


def evenly(name="a", n=5, dt=0.1, columns=1):
    zeros = np.zeros((n, columns))
    return Episode(name, dt * np.arange(n), zeros, zeros, zeros)


def timed(*time):
    zeros = np.zeros((len(time), 1))
    return Episode("a", time, zeros, zeros, zeros)


GAPPED = [timed(0, 0.1, 0.2, 0.6, 0.7)]
UNEVEN = [timed(0, 0.1, 0.2, 0.3, 0.42)]


@pytest.mark.parametrize(
    ("episodes", "text"),
    [
        ([], "there are no episodes; a data set holds at least one"),
        ([evenly(), evenly()], "more than one episode is named a; names must be unique"),
        ([evenly(), evenly("b", columns=2)], "episode 'b' has nq=2, nv=2, nu=2 and episode 'a' has nq=1, nv=1, nu=1"),
        ([evenly("a"), evenly("b"), evenly("c", dt=0.11)], "episode 'c' has a control step of 0.11 s where the median"),
        (GAPPED, "episode 'a', row 3: 0.4 s passed since the row before, where the median step is 0.1 s"),
        (GAPPED, "about 3 row(s) are missing there (1 such gap(s) in the episode). Split the episode there"),
        (UNEVEN, "episode 'a': the steps in time are uneven, from 0.1 to 0.12 s around 0.105 s"),
        (UNEVEN, "(worst before row 4: 14.3 % off, at most 1 % is allowed)"),
        ([timed(0, 0.0200602, 0.0401204, 0.061)], "resample=0.02)"),
        ([timed(0, 0.0166667, 0.0333333, 0.0505)], "resample=0.0167)"),
        (UNEVEN, "Resample it: load_dataset(..., resample=0.1), or resample_episode"),
    ],
)
def test_dataset_refusals(episodes, text):
    """A data set refuses episodes that do not belong together or are not evenly spaced."""
    with pytest.raises(BadDataset, match=re.escape(text)):
        Dataset(episodes)


def test_small_jitter_is_allowed():
    """Steps within 1 % of their mean count as even, and 1.1 % do not."""
    steps = np.array([1, 1.009, 0.991, 1, 1])
    assert Dataset([timed(0, *np.cumsum(steps))]).control_dt == 1.0
    with pytest.raises(BadDataset, match="uneven"):
        Dataset([timed(0, *np.cumsum(1 + 1.25 * (steps - 1)))])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"name": 3}, "an episode's name is 3; it must be printable text"),
        ({"name": "a\nb"}, r"an episode's name is 'a\nb'; it must be printable text"),
        ({"robot": ""}, "episode 'a': the robot label is ''; it must be printable text"),
        ({"qpos": [[1], [2, 3]]}, "episode 'a': qpos is no array of equal rows"),
        ({"qpos": [[1], [2], [3]]}, "episode 'a': qpos has 3 rows and time has 2"),
        ({"qpos": np.array([[1], [None]])}, "episode 'a': qpos holds Python objects"),
        ({"time": [0, 10**400]}, "episode 'a': time holds Python objects"),
        ({"qvel": np.ma.masked_equal([[1], [2]], 2)}, "episode 'a': qvel is masked in part; split the episode"),
        ({"ctrl": [0, 0]}, "episode 'a': ctrl has shape (2,); it must have two dimensions"),
        ({"qvel": np.array([[1], [1e300]], np.longdouble) ** 2}, "row 1, column qvel_0: the value is inf"),
    ],
)
def test_episode_refusals(changes, text):
    """An episode made directly is checked like one from a file."""
    fields = {"name": "a", "time": [0, 1], "qpos": [[1], [2]], "qvel": [[1], [2]], "ctrl": [[0], [0]]} | changes
    with pytest.raises(BadDataset, match=re.escape(text)):
        Episode(**fields)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda d: d.windows(5), BadDataset, "takes 6 rows, and the longest episode has 5. Use a horizon of at most 4"),
        (lambda d: d.windows(0), BadInput, "horizon is 0; it must be a whole number, at least 1"),
        (lambda d: d.windows(2.0), BadInput, "horizon is 2.0; it must be a whole number"),
        (lambda d: d.windows(2, stride=0), BadInput, "stride is 0; it must be a whole number, at least 1"),
        (lambda d: d.transitions(history=-1), BadInput, "history is -1; it must be a whole number, at least 0"),
        (lambda d: next(d.transitions().batches(0)), BadInput, "size is 0; it must be a whole number, at least 1"),
        (lambda d: d.transitions()[99], IndexError, "window 99 of 8"),
        (lambda d: d.split(1.0), BadInput, "held_out is 1.0; a share must lie between 0 and 1, both excluded"),
        (lambda d: d.split(None), BadInput, "held_out is None; give a share between 0 and 1, or a list of names"),
        (lambda d: d.split("a"), BadInput, "held_out is the text 'a'; give a share or a list of names: ['a']"),
        (lambda d: d.split(["z"]), BadInput, "no episode or robot is named 'z'; there are a, b"),
        (lambda d: d.split(["a", "b"]), BadDataset, "leaves 0 of 2 episodes in and 2 held out; both sides need"),
        (lambda d: d.split([]), BadDataset, "leaves 2 of 2 episodes in and 0 held out"),
        (lambda d: d.subset([0]).split(0.5), BadDataset, "leaves 0 of 1 episodes in and 1 held out"),
        (lambda d: d.resample(0), BadInput, "control_dt is 0; it must be a positive number of seconds"),
        (lambda d: d.resample("fast"), BadInput, "control_dt is 'fast'; it must be a number of seconds"),
        (lambda d: d.resample(9), BadDataset, "lasts 0.4 s, less than one control step of 9 s"),
    ],
)
def test_argument_refusals(call, error, text):
    """Arguments that make no sense are refused with the rule."""
    with pytest.raises(error, match=re.escape(text)):
        call(Dataset([evenly("a"), evenly("b")], source="log.npz"))


def test_errors_of_a_loaded_dataset_name_the_file():
    """What is found later still names the file the data came from."""
    with pytest.raises(BadDataset, match=r"^log\.npz: no episode is long enough"):
        Dataset([evenly()], source="log.npz").windows(9)


def test_ambiguous_name_in_split():
    """A name that is one episode and another robot is refused."""
    a = Episode("a", [0, 1], [[1], [2]], [[1], [2]], [[], []], robot="b")
    b = Episode("b", [0, 1], [[1], [2]], [[1], [2]], [[], []], robot="c")
    with pytest.raises(BadInput, match="'b' is an episode and a robot; rename one of them"):
        Dataset([a, b]).split(["b"])


def test_zero_quaternion_cannot_be_resampled():
    """A quaternion of length zero has no direction to turn."""
    e = Episode("a", [0, 1], [[1, 0, 0, 0], [0, 0, 0, 0]], np.zeros((2, 3)), np.zeros((2, 0)))
    with pytest.raises(BadDataset, match="row 1, column qpos_0: the quaternion is zero"):
        resample_episode(e, 0.5, quaternions=[0])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"state": np.zeros((2, 1, 2))}, "state has shape (2, 1, 2), expected (2, 2, 2)"),
        ({"state": np.zeros((2, 2, 3))}, "state has shape (2, 2, 3), expected (2, 2, 2)"),
        ({"ctrl": np.zeros((2, 2, 1))}, "ctrl has shape (2, 2, 1), expected (2, 1, 1)"),
        ({"history": np.zeros((1, 4, 1))}, "history has shape (1, 4, 1), expected (2, 4, 1)"),
        ({"row": [0]}, "row has shape (1,), expected (2,)"),
        ({"row": [0.5, 1]}, "row must hold whole numbers, not float64"),
        ({"ctrl": np.full((2, 1, 1), np.nan)}, "ctrl of window 0 is not finite"),
        ({"control_dt": 0.0}, "control_dt is 0.0; it must be a positive number of seconds"),
    ],
)
def test_windows_refusals(changes, text):
    """Windows made by hand are checked against each other."""
    fields = {
        "state": np.zeros((2, 2, 2)),
        "ctrl": np.zeros((2, 1, 1)),
        "history": np.zeros((2, 0, 1)),
        "control_dt": 0.1,
        "nq": 1,
        "nv": 1,
        "episode": [0, 0],
        "row": [0, 1],
    }
    assert len(Windows(**fields)) == 2
    with pytest.raises(BadInput, match=re.escape(text)):
        Windows(**(fields | changes))


def test_metadata_refusals():
    """Values of the wrong type are refused at creation."""
    with pytest.raises(BadDataset, match="the metadata's control_dt is -1; it must be a positive number of seconds"):
        Metadata(control_dt=-1)
    with pytest.raises(BadDataset, match="the metadata's solver is 3; it must be text"):
        Metadata(solver=3)  # pyright: ignore[reportArgumentType]
    with pytest.raises(BadDataset, match="a qpos column's name is ''; it must be printable"):
        ColumnNames(qpos=("",))
