"""`--resample` of recordings with free and ball joints: the model says which columns are quaternions."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from nfpde.cli import diagnose, fit
from nfpde.dataset import ColumnNames, Dataset, Episode, save_dataset
from nfpde.errors import BadInput
from tests.command_line import run
from tests.models import FREE_BOX

KNEE = '<body pos="0 0 -0.3"><joint name="knee" axis="0 1 0"/><geom size="0.05"/></body>'
ROBOT = FREE_BOX.replace("</body>", KNEE + "</body>", 1)
NAMES = ("knee", *(f"root[{i}]" for i in range(7)))
SPEEDS = ("knee", *(f"root[{i}]" for i in range(6)))
PARAMETER = '[[parameter]]\nfield = "body_mass"\ntarget = "box"\nlow = 0.5\nhigh = 2\n'


def turning(time):
    """A trunk that moves steadily and turns about one axis at constant rate, and its knee."""
    turn = Rotation.from_rotvec(np.outer(3 * time, [0.6, 0, 0.8])).as_quat(scalar_first=True)
    return np.hstack([np.outer(time, [1, 2, 3]), turn, 0.5 * time[:, None]])


def write(path, order=None):
    """Recordings with an uneven clock; with an order of the qpos columns, named."""
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.009, 0.011, 80))
    qpos, qvel = turning(time), rng.normal(size=(80, 7))
    arrays = {"qpos": qpos, "qvel": qvel}
    if order is not None:
        own = dict(zip((*NAMES[1:], "knee"), qpos.T, strict=True))
        arrays["qpos"] = np.stack([own[name] for name in order], axis=1)
        arrays["qvel"] = np.roll(qvel, 1, axis=1)
        arrays |= {"qpos_names": np.array(order), "qvel_names": np.array(SPEEDS)}
    np.savez(path, episode=np.zeros(80, int), time=time, ctrl=np.zeros((80, 0)), **arrays)
    return time[0]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot.xml").write_text(ROBOT)
    (tmp_path / "parameters.toml").write_text(PARAMETER)
    return tmp_path


def loaded(folder, monkeypatch, command, data) -> Any:
    """What a command reads of a file, or what it says."""
    seen = []

    def stop(model, dataset, *_, **__):
        seen.append(dataset)
        raise BadInput("seen")

    monkeypatch.setattr(*((diagnose, "diagnose_gap") if command == "diagnose" else (fit, "fit")), stop)
    options = ("--out", folder / "out", "--params", folder / "parameters.toml", "--resample", "0.01", "--device", "cpu")
    _, _, err = run(command, folder / "robot.xml", data, *options)
    return seen[0] if seen else err


@pytest.mark.parametrize("command", ["diagnose", "fit"])
@pytest.mark.parametrize("named", [False, True])
def test_quaternions_are_those_of_the_model(folder, monkeypatch, command, named):
    """Numbered in the model's order, or named in another one: the trunk turns as steadily as it did."""
    start = write(folder / "data.npz", NAMES if named else None)
    data = loaded(folder, monkeypatch, command, folder / "data.npz")
    qpos = data.episodes[0].qpos
    expected = turning(start + 0.01 * np.arange(len(qpos)))
    assert len(qpos) > 70
    # slerp about one axis is exact but for rounding, linear interpolation only for the rest
    assert_allclose(np.roll(qpos, -1, axis=1) if named else qpos, expected, rtol=0, atol=1e-12)


def test_named_columns_that_are_no_quaternion_are_refused(folder, monkeypatch):
    """Columns that are not side by side, or that the model does not have."""
    shuffled = (*NAMES[:4], NAMES[5], NAMES[4], *NAMES[6:])
    write(folder / "data.npz", shuffled)
    text = loaded(folder, monkeypatch, "diagnose", folder / "data.npz")
    assert "data.npz: to be resampled or differentiated, the qpos columns root[3], root[4], root[5], root[6]" in text
    assert "the data has knee, root[0], root[1], root[2], root[4], root[3], root[5], root[6]. Rename or reorder" in text
    time = np.arange(30) * 0.01
    names = ColumnNames(qpos=tuple(f"trunk{i}" for i in range(8)), qvel=SPEEDS)
    other = Dataset([Episode("0", time, turning(time), np.zeros((30, 7)), np.zeros((30, 0)))], column_names=names)
    save_dataset(other, folder / "other.csv")
    assert "the data has trunk0, trunk1," in loaded(folder, monkeypatch, "fit", folder / "other.csv")


def test_a_model_that_was_not_recorded(folder, monkeypatch):
    """Its quaternions are not those of the recordings."""
    write(folder / "data.npz")
    (folder / "robot.xml").write_text(FREE_BOX.replace('<freejoint name="root"/>', '<joint name="root"/>'))
    text = loaded(folder, monkeypatch, "diagnose", folder / "data.npz")
    assert "nq=8 and nv=7, so 1 unit quaternion(s), and quaternions=[]" in text
    assert "it must be the one that was recorded" in text
