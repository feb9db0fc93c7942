"""The cells of the estimators' benchmark: verdicts and reasons, going on where it stopped, what is refused."""

import json
from dataclasses import replace

import pytest
import torch

from nfpde.bench import estimation
from nfpde.bench.estimation import calibration, cell, grid, stages, table, temperature, verdicts
from nfpde.bench.estimation.command import split
from nfpde.errors import BadInput
from nfpde.estimation import NfpdeConfig, TrajectoryConfig
from tests.command_line import run

torch.set_num_threads(1)


def finished_cell(**changes):
    """A made-up cell of two robots with two parameters, in the form that `measure` writes."""
    distance = {"to_episodes": {"physical": 1.0, "box": 0.5}, "to_population": {"physical": 1.0, "box": 0.5}}
    softmax_fit = {"beta": 1e-3, "automatic": True, "effective": 5.0, "score": 1.0, "million_steps": 5.0}
    content = {
        "cell": {"robot": "hopper", "target": "mixture", "noise": 0.0, "seed": 0},
        "parameters": ["mass", "geom_friction:floor"],
        "width": [1.0, 2.0],
        "before": dict.fromkeys(("uniform", "initial", "population"), distance),
        "softmax": {"fits": [softmax_fit | distance | {"cpu_seconds": 1.0}], "chosen": 0, "oracle": 0},
        "trajectory": {
            "episodes": {"to_episodes": {"physical": 0.01, "box": 0.01}, "to_population": distance["to_population"]},
            "population": distance,
            "million_steps": 1.0,
            "seconds": 1.0,
            "cpu_seconds": 2.0,
            "rounds": 3,
            "info": {"population": {"chosen": "a Gaussian"}},
            "robots": {
                "value": [[0.5, 1.0], [0.5, 1.0]],
                "true": [[0.5, 1.0], [0.5, 1.0]],
                "std": [[1e-3, 1e-3], [1e-3, 1e-3]],
                "cramer_rao": [[1e-3, None], [1e-3, 1e-3]],
                "known": [[1.0, 0.1], [1.0, 1.0]],
            },
            "residuals": {"fitted": [1e-20, 1e-20], "true": [1e-20, 1e-20]},
        },
        "bound": {
            "one_step": None,
            "whole": None,
            "sensitivity": [[0.1, 0.0], [0.1, 0.1]],
            "felt": [[1, 0.0], [1, 0.5]],
        },
        "steps_per_core_second": 1e5,
        "settings": {},
        "device": "cpu: double precision",
        "code": {"softmax": "a", "trajectory": "b"},
        "versions": {},
        "machine": "m",
    }
    return content | changes


def failed(content):
    return {v.name: v.text for v in verdicts.judge(content) if not v.passed}


def test_a_cell_that_meets_everything_passes():
    """Close to the truth, fewer steps, not farther from fresh draws, faster: 1e6 steps on two cores take 5 s."""
    assert failed(finished_cell()) == {}
    assert verdicts.seconds(finished_cell(), {"million_steps": 1.0}) == 5.0
    assert "| pass |" in table.line(finished_cell())


def test_a_busy_machine_makes_no_cell_slow():
    """Whatever else runs only slows: the fastest rate of a robot on a device is that of all its cells."""
    cells = [finished_cell(steps_per_core_second=r) for r in (2e4, 4e4)]
    other = finished_cell(steps_per_core_second=1e3, device="cuda: single precision")
    rates = [c["steps_per_core_second"] for c in grid._alone([*cells, other])]
    assert rates == [4e4, 4e4, 1e3]
    assert cells[0]["steps_per_core_second"] == 2e4


def test_a_failure_names_the_parameter_that_the_recordings_do_not_tell():
    """The reason gives the parameter's share of the squared error and the episodes that hardly show it."""
    content = finished_cell()
    near = content["trajectory"]["episodes"]["to_episodes"]
    content["trajectory"]["episodes"]["to_episodes"] = near | {"physical": 0.5}
    content["trajectory"]["robots"]["value"] = [[0.5, 1.4], [0.5, 1.0]]
    text = failed(content)["ratio"]
    assert "OT 0.5, 0.5 of softmax's, at most 0.05 wanted" in text
    assert "100% of the squared error is geom_friction:floor's, which 1 of 2 episodes hardly tell" in text
    assert "local minimum" not in text
    page = table.table([content], "command")
    assert "FAIL: ratio" in page
    assert "## Floor friction" in page
    assert "| 0% 50% | none 0.0005 | 10% 100% | 0.2 0 |" in page
    assert "1 of 2 episodes leave it unknown" in page


def test_a_population_too_wide_is_named():
    """Farther from fresh draws than softmax: the reason gives what fresh draws themselves get, and which it is."""
    content = finished_cell()
    far = {"to_episodes": {"physical": 1.0}, "to_population": {"physical": 2.0}}
    content["trajectory"]["population"] = far
    assert failed(content) == {
        "fresh": "OT to fresh draws 2, softmax 1; fresh draws of the truth are at 1; the population is a Gaussian"
    }


def test_what_the_distance_cannot_tell_is_said():
    """A failure beside fresh draws gives its scatter, what can be known of the population, and what is rated better."""
    content = finished_cell(
        yardsticks={"truth": [1.0, 1.1], "moments": [1.5, 1.7], "narrowed": {"0.9": 0.9, "0.7": 0.8}}
    )
    content["trajectory"]["population"] = {"to_episodes": {"physical": 1.0}, "to_population": {"physical": 2.0}}
    content["trajectory"]["redrawn"] = [1.9, 2.1]
    text = failed(content)["fresh"]
    assert "over 2 other draws it is at 2 (standard deviation 0.1)" in text
    assert "true mean and standard deviations is at 1.6" in text
    assert "narrowed to 0.7 of its own is at 0.8" in text
    content["yardsticks"]["narrowed"] = {"0.9": 1.2}
    assert "no judge" not in failed(content)["fresh"]


def test_a_local_minimum_is_told_from_ignorance():
    """A fit that explains its recording worse than the truth does sits in a local minimum."""
    content = finished_cell(cell={"robot": "hopper", "target": "mixture", "noise": 0.01, "seed": 0})
    content["bound"] = {
        "one_step": [[0.01, 0.01]] * 2,
        "whole": [[0.01, 0.01]] * 2,
        "sensitivity": [[1, 1]] * 2,
        "felt": [[1, 1]] * 2,
    }
    content["trajectory"]["robots"]["value"] = [[0.9, 1.0], [0.5, 1.0]]
    content["trajectory"]["residuals"] = {"fitted": [0.9, 0.1], "true": [0.1, 0.1]}
    assert verdicts.local_minima(content) == [0]
    # the only error is 0.4 in one of four numbers, whose bounds are all 0.01
    assert verdicts.errors(content)["over_bound"] == pytest.approx(20.0)
    text = failed(content)["bound"]
    assert "error 20.00 x bound" in text
    assert "1 of 2 robots end in a local minimum" in text
    assert "1 of 2 robots end more than 5 of their own standard deviations from the truth, with 100%" in text
    content["trajectory"]["robots"]["std"] = [[0.09, 1e-3], [1e-3, 1e-3]]  # 0.4 is 4.4 of it
    assert verdicts.astray(content) == []
    assert "standard deviations from the truth" not in failed(content)["bound"]
    assert "small noise" not in failed(content)["whole"]
    content["bending"] = {"error": 0.25, "often": 0.5, "whole": [[0.03, 0.03]] * 2}
    text = failed(content)["whole"]
    assert "wrong by 0.25 of the noise (median channel), and in 50.0% of the transitions by more" in text
    assert "the bound is 3 x as wide" in text


TINY = replace(
    cell.QUICK,
    softmax=NfpdeConfig(iterations=1, samples=20, transitions=4, transforms=2, hidden=8, gradient_steps=1),
    trajectory=TrajectoryConfig(starts=1, steps=2, rounds=2),
    samples=50,
    episodes=2,
    steps=12,
)


def test_the_grid_goes_on_and_grows(tmp_path, monkeypatch, capsys):
    """Two calls make one table of two cells; a third fits nothing; out of time nothing begins."""
    monkeypatch.setattr(grid, "Settings", lambda: TINY)
    monkeypatch.setattr(temperature, "VECTORS", 20)
    fitted = []
    real = cell.fit
    monkeypatch.setattr(cell, "fit", lambda *a, **k: fitted.append(k["method"]) or real(*a, **k))
    few = {"robots": ["pendulum"], "targets": ["gaussian"], "seeds": [0]}
    assert not estimation.run(tmp_path, noises=[0.0], budget_minutes=1e-9, **few)
    assert fitted == []
    assert "0 of 1 cells are finished: give the command again" in capsys.readouterr().out
    assert estimation.run(tmp_path, noises=[0.0], **few)
    assert fitted == ["softmax", "softmax", "trajectory"]
    assert estimation.run(tmp_path, noises=[0.01], **few)
    assert len(fitted) == 6
    assert estimation.run(tmp_path, noises=[0.0, 0.01], **few)
    assert len(fitted) == 6
    page = (tmp_path / "estimation.md").read_text()
    assert page.count("| pendulum | gaussian |") == 2
    assert "nfpde bench estimation" in page
    rows = json.loads((tmp_path / "estimation.json").read_text())["rows"]
    assert [r["noise"] for r in rows] == [0.0, 0.01]
    assert [v["name"] for v in rows[1]["verdicts"]] == ["closer", "bound", "whole", "fresh"]
    path = tmp_path / "estimation" / "pendulum_gaussian_0.01_0.json"
    content = json.loads(path.read_text())
    found = stages.results(content)
    assert len(found["bound"]["whole"]) == len(found["trajectory"]["robots"]["true"]) == 2
    assert content["stages"]["trajectory"]["provenance"]["commit"] == stages.provenance()["commit"]
    content["stages"]["trajectory"]["provenance"]["commit"] = "older"
    path.write_text(json.dumps(content))
    assert estimation.run(tmp_path, noises=[0.0, 0.01], refit=True, **few)
    assert fitted[6:] == ["trajectory"]
    # the same seeds and code: all but times are the same
    again = stages.results(json.loads(path.read_text()))
    assert again["trajectory"]["robots"] == found["trajectory"]["robots"]


def test_calibration_goes_on(tmp_path, monkeypatch):
    """Finished problems are kept; coverage, ranks and a picture are there at the end."""
    tiny = replace(calibration.QUICK, trajectory=TINY.trajectory, steps=12, samples=19)
    monkeypatch.setattr(calibration, "QUICK", tiny)
    assert not estimation.calibrate(tmp_path, quick=True, budget_minutes=1e-9)
    assert estimation.calibrate(tmp_path, quick=True)
    content = json.loads((tmp_path / "calibration_quick" / "pendulum.json").read_text())
    problems = stages.results(content)
    assert list(problems) == [f"{i}" for i in range(calibration.QUICK_PROBLEMS)]
    assert all(0 <= r <= 19 for p in problems.values() for r in p["rank"])
    assert (tmp_path / "calibration_quick" / "pendulum_anew.png").is_file()
    monkeypatch.setattr(calibration, "problem", None)
    assert estimation.calibrate(tmp_path, quick=True)
    page = (tmp_path / "calibration_quick.md").read_text()
    assert page.count("| dof_damping:hinge |") == len(calibration.SENSING)
    assert "## pendulum, measured anew" in page
    # posteriors that are above the truth in every problem
    for stage in content["stages"].values():
        stage["result"] |= {"rank": [0, 0], "true": [1.0, 1.0], "mean": [3.0, 2.0], "std": [1.0, 1.0]}
    (tmp_path / "calibration_quick" / "pendulum.json").write_text(json.dumps(content))
    assert estimation.calibrate(tmp_path, quick=True)
    page = (tmp_path / "calibration_quick.md").read_text()
    assert "- pendulum, body_mass:pendulum, 90 %: 0%; errors are 2.00 ± 0.58 posterior standard deviations" in page


def test_calibration_with_other_settings_is_measured_anew(tmp_path, monkeypatch):
    """Problems of other settings never end up in one table, finished or not; more problems keep those there are."""
    measured = []

    def problem(name, sensing, settings, index, device):
        measured.append((sensing, index, settings.samples))
        if len(measured) == stop:
            raise KeyboardInterrupt
        figures = dict.fromkeys(("noise", "transitions", "modes", "million_steps", "seconds"), 1.0)
        return figures | {"rank": [3, 4], "true": [1.0, 1.0], "mean": [1.0, 1.0], "std": [1.0, 1.0]}

    monkeypatch.setattr(calibration, "problem", problem)
    stop = 0
    assert estimation.calibrate(tmp_path, quick=True)
    first = [(s, i, calibration.QUICK.samples) for s in calibration.SENSING for i in range(calibration.QUICK_PROBLEMS)]
    assert measured == first
    monkeypatch.setattr(calibration, "QUICK_PROBLEMS", calibration.QUICK_PROBLEMS + 1)
    measured.clear()
    assert estimation.calibrate(tmp_path, quick=True)
    assert [index for _, index, _ in measured] == [3] * len(calibration.SENSING)
    monkeypatch.setattr(calibration, "QUICK", replace(calibration.QUICK, samples=29))
    stop = 3
    measured.clear()
    with pytest.raises(KeyboardInterrupt):
        estimation.calibrate(tmp_path, quick=True)
    assert measured == [("", 0, 29), ("", 1, 29), ("", 2, 29)]
    # what was finished with 29 samples is not counted among problems of 39, though it is on disk
    monkeypatch.setattr(calibration, "QUICK", replace(calibration.QUICK, samples=39))
    stop = 0
    measured.clear()
    assert estimation.calibrate(tmp_path, quick=True)
    assert measured == [(s, i, 39) for s in calibration.SENSING for i in range(4)]
    content = json.loads((tmp_path / "calibration_quick" / "pendulum.json").read_text())
    assert {stage["settings"]["settings"]["samples"] for stage in content["stages"].values()} == {39}


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"robots": ["ant"]}, "no benchmark robot is called 'ant'"),
        ({"targets": ["ring"]}, "no target population is called 'ring'; there are: gaussian, mixture"),
        ({"noises": [1.5]}, "noise is 1.5; it must be a share"),
        ({"seeds": [-1]}, "seed must be at least 0, got -1"),
    ],
)
def test_what_is_no_cell_is_refused(tmp_path, wrong, text):
    """Before anything is recorded."""
    with pytest.raises(BadInput, match=text):
        estimation.run(tmp_path, **wrong)


def test_lists_of_the_command_line():
    """Entries between commas; what is no number is named."""
    assert split("noises", "0, 0.001,") == [0.0, 0.001]
    with pytest.raises(BadInput, match=r"seeds: '1.5' is not an integer; give a list with commas, like 0,1"):
        split("seeds", "0,1.5")
    with pytest.raises(BadInput, match="robots is empty; give at least one"):
        split("robots", ",")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ("--quick --robots hopper", "--robots is no setting of --quick, which has cells of its own"),
        ("--quick --targets gaussian", "--targets is no setting of --quick"),
        ("--quick --seeds 0", "--seeds is no setting of --quick"),
        ("--quick --calibration --problems 100", "--problems is no setting of --quick"),
        ("--calibration --noise 0", "--noise is no setting of --calibration, where it would do nothing; leave it out"),
        ("--calibration --quick --refit", "--refit is no setting of --calibration"),
        ("--problems 3", "--problems is no setting of the cells, only of --calibration"),
    ],
)
def test_options_that_would_do_nothing_are_refused(tmp_path, options, text):
    """Even with their default; nothing is measured or written."""
    status, out, err = run("bench", "estimation", *options.split(), "--out", tmp_path / "out")
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert text in err
    assert not (tmp_path / "out").exists()
