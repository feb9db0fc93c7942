"""`nfpde diagnose` from the command line."""

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from nfpde.cli import app, diagnose
from nfpde.dataset import save_dataset
from nfpde.parameters import ParameterSpace
from nfpde.sim import MujocoSimulator
from tests.command_line import run
from tests.gap_reports import arm, gap_report
from tests.gap_systems import ARM, record


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """An arm with a stiff cable at its elbow, diagnosed on few windows."""
    folder = tmp_path_factory.mktemp("diagnose")
    (folder / "arm.xml").write_text(ARM)
    data = record(force=lambda d: -3.0 * (d.qpos[1] - 0.2), noise=1e-3, seed=5)
    save_dataset(data, folder / "data.npz")
    call = ["diagnose", str(folder / "arm.xml"), str(folder / "data.npz"), "--out", str(folder / "out")]
    return folder, CliRunner().invoke(app, [*call, "--windows", "60"])


def test_it_writes_the_answer_and_the_page(diagnosed):
    """diagnosis.json names the spring with its stiffness and rest; the page and the picture stand beside it."""
    folder, result = diagnosed
    assert result.exit_code == 0, result.output
    found = json.loads((folder / "out" / "diagnosis.json").read_text())
    cause = found["effects"][0]
    assert (cause["effect"], cause["target"]) == ("joint_spring", "elbow")
    assert cause["parameters"]["stiffness"]["value"] == pytest.approx(3.0, rel=0.03)  # sensor noise of a thousandth
    assert cause["parameters"]["rest"]["value"] == pytest.approx(0.2, abs=0.02)
    assert (folder / "out" / "report.html").stat().st_size > 1000
    assert (folder / "out" / "summary.png").exists()


def test_it_says_so_in_plain_words(diagnosed):
    """The terminal shows the cause, its value and where the pages are."""
    _, result = diagnosed
    assert "joint_spring at elbow" in result.output
    assert "report.html" in result.output


def test_it_writes_what_to_fit_next(diagnosed):
    """The spring's parameters, as `nfpde fit --params` reads them."""
    folder, result = diagnosed
    assert f"{folder / 'data.npz'} --params {folder / 'out' / 'explained.toml'} --out" in result.output
    space = ParameterSpace.from_toml(folder / "out" / "explained.toml")
    assert space.names == ["joint_spring.stiffness:elbow", "joint_spring.rest:elbow"]
    assert (space[0].low, space[0].high) == pytest.approx((1.5, 4.5), rel=0.03)  # sensor noise of a thousandth
    MujocoSimulator(folder / "arm.xml", space)


@pytest.mark.parametrize(("verdict", "written"), [("unexplained", False), ("no_gap", False), ("effects", True)])
def test_nothing_of_an_earlier_diagnosis_is_left(diagnosed, monkeypatch, tmp_path, verdict, written):
    """Where there is nothing to fit next there is no file, and no word of one."""
    folder, _ = diagnosed
    (tmp_path / "explained.toml").write_text("of another day")
    found = gap_report(arm(), verdict)
    found = replace(found, effects=found.effects[:1], base={})  # friction at the elbow
    monkeypatch.setattr(diagnose, "diagnose_gap", lambda *_, **__: found)
    status, out, err = run("diagnose", folder / "arm.xml", folder / "data.npz", "--out", tmp_path)
    assert (status, err) == (0, "")
    assert (tmp_path / "explained.toml").exists() == ("what to fit next" in out) == written
    if written:
        assert "coulomb_friction" in (tmp_path / "explained.toml").read_text()


def test_the_next_command_can_be_copied(diagnosed, monkeypatch, tmp_path):
    """Paths with spaces are quoted, and what the diagnosis did to uneven clocks the fit has to do, too."""
    folder, _ = diagnosed
    found = gap_report(arm(), "effects")
    found = replace(found, effects=found.effects[:1], base={})
    monkeypatch.setattr(diagnose, "diagnose_gap", lambda *_, **__: found)
    out = tmp_path / "to day"
    status, said, _ = run("diagnose", folder / "arm.xml", folder / "data.npz", "--out", out, "--resample", 0.02)
    assert status == 0
    assert f"--params '{out / 'explained.toml'}' --resample 0.02 --out" in said


def test_its_own_output_is_no_input(diagnosed):
    """A second diagnosis into the same folder would take away the file it was given."""
    folder, _ = diagnosed
    own = folder / "out" / "explained.toml"
    call = ("diagnose", folder / "arm.xml", folder / "data.npz", "--params", own, "--out", folder / "out")
    status, _, err = run(*call)
    assert status == 1
    assert "explained.toml is what the diagnosis of" in err
    assert "give another folder" in err
    assert own.exists()


def test_a_folder_that_cannot_be_made_is_told_first(diagnosed, monkeypatch):
    """No minutes of work whose answer has nowhere to go."""
    folder, _ = diagnosed
    (folder / "taken").write_text("a file")
    monkeypatch.setattr(diagnose, "diagnose_gap", lambda *_, **__: pytest.fail("worked first"))
    status, out, err = run("diagnose", folder / "arm.xml", folder / "data.npz", "--out", folder / "taken")
    assert (status, out) == (1, "")
    assert "taken: File exists" in err


def test_a_seed_below_zero(diagnosed):
    """Refused by the command's usage."""
    folder, _ = diagnosed
    assert run("diagnose", folder / "arm.xml", folder / "data.npz", "--out", folder / "x", "--seed", "-1")[0] == 2
