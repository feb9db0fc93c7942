"""Problems of the calibration are kept whatever number is asked for, and each robot is listed once."""

import json

import pytest

from nfpde.bench import estimation
from nfpde.bench.estimation import calibration, stages

FOUND = {
    "rank": [100, 800],
    "true": [1.0, 1.0],
    "value": [1.1, 0.9],
    "mean": [1.1, 0.9],
    "std": [0.1, 0.1],
    "noise": 0.01,
    "transitions": 99,
    "modes": 1,
    "million_steps": 0.1,
    "seconds": 1.0,
}

FILES = ["pendulum.json", "pendulum_anew.json", "pendulum_differenced.json", "pendulum_filtered.json"]


@pytest.fixture
def calibrate(tmp_path, monkeypatch):
    """Runs so many problems of the pendulum, which cost nothing; gives the page, the files and the numbers kept."""
    monkeypatch.setattr(calibration, "problem", lambda *_: FOUND)
    monkeypatch.setattr(calibration, "draw_ranks", lambda *_: None)

    def run(problems, budget_minutes=None):
        estimation.calibrate(tmp_path, robots=["pendulum"], problems=problems, budget_minutes=budget_minutes)
        folder = tmp_path / "calibration"
        kept = {p.name: len(stages.results(json.loads(p.read_text()))) for p in sorted(folder.glob("*.json"))}
        return (tmp_path / "calibration.md").read_text(), kept

    return run


def test_fewer_problems_drop_none(calibrate):
    """Of four finished problems two that are asked for are there, and the others stay."""
    assert calibrate(4)[1] == dict.fromkeys(FILES, 4)
    page, kept = calibrate(2)
    assert kept == dict.fromkeys(FILES, 4)
    assert "4 of 4 problems" in page
    assert calibrate(5)[1] == dict.fromkeys(FILES, 5)


def test_a_robot_that_is_being_added_to_is_listed_once(calibrate, tmp_path):
    """With the finished file and the unfinished one side by side, the second has all problems and is shown."""
    calibrate(2)
    finished = tmp_path / "calibration" / "pendulum.json"
    content = json.loads(finished.read_text())
    stage = content["stages"]["0"]
    content["facts"]["problems"], content["stages"]["2"] = 4, {**stage, "provenance": stages.provenance()}
    finished.with_suffix(".part.json").write_text(json.dumps(content))
    page, kept = calibrate(4, budget_minutes=1e-9)
    assert kept == {**dict.fromkeys(FILES, 2), "pendulum.part.json": 3}
    assert page.count("## pendulum\n") == 1
    assert "3 of 4 problems" in page
