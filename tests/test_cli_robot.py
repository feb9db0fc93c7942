"""`--robot`: of recordings of several robots those of one, in a diagnosis and in the fit that follows it."""

import json
import shlex
from dataclasses import replace

import pytest

from nfpde.cli import diagnose
from nfpde.dataset import load_dataset, save_dataset
from tests.command_line import TINY, run
from tests.gap_reports import arm, gap_report


@pytest.fixture
def data(tmp_path):
    """Recordings of two pendulums, two of each."""
    call = ("collect", "pendulum", "--robots", 2, "--episodes", 4, "--steps", 30)
    assert run(*call, "--out", tmp_path / "data")[::2] == (0, "")
    return tmp_path / "data"


def test_a_fit_of_one_robot(data, tmp_path):
    """Its recordings alone; another robot's are other recordings, in which the same folder is no use."""
    both = load_dataset(data / "data.npz")
    for robot in both.robots:
        out = tmp_path / robot
        assert run("fit", "pendulum", data, "--robot", robot, "--out", out, *TINY)[::2] == (0, "")
        own = replace(both, episodes=[e for e in both if e.robot == robot])
        assert len(own) == 2
        assert json.loads((out / "fit.json").read_text())["dataset"] == own.content_hash()
    first, second = both.robots
    for others in (("--robot", second), ()):
        status, _, err = run("fit", "pendulum", data, *others, "--out", tmp_path / first, *TINY)
        assert status == 1
        assert "dataset" in err


def test_a_robot_that_was_not_recorded(data, tmp_path):
    """The labels that there are are named."""
    both = load_dataset(data / "data.npz")
    call = ("fit", "pendulum", data, "--robot", "Marvin", "--out", tmp_path / "out")
    labels = " and ".join(both.robots)
    assert run(*call) == (1, "", f"nfpde: there is no robot 'Marvin' in these recordings of {labels}\n")
    save_dataset(replace(both, episodes=[replace(e, robot=None) for e in both]), data / "data.npz")
    assert run(*call) == (1, "", "nfpde: there is no robot 'Marvin' in these recordings that name no robot\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("robot", ["A", "the left one"])
def test_a_diagnosis_sends_the_same_robot_to_the_fit(data, monkeypatch, tmp_path, robot):
    """The bounds are around its values."""
    found = gap_report(arm(), "effects")
    found = replace(found, effects=found.effects[:1], base={})
    monkeypatch.setattr(diagnose, "diagnose_gap", lambda *_, **__: found)
    status, said, _ = run("diagnose", "pendulum", data, "--robot", robot, "--out", tmp_path / "out")
    assert status == 0
    assert f"explained.toml --robot {shlex.quote(robot)} --out ..." in said
