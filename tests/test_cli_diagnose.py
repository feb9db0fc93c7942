"""`nfpde diagnose` from the command line."""

import json

import pytest
from typer.testing import CliRunner

from nfpde.cli import app, diagnose
from nfpde.dataset import save_dataset
from tests.command_line import run
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
