"""The table of real robots, on recordings made up in the layouts of the published ones."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from nfpde.bench.real import run as bench
from nfpde.bench.real.cases import CASES
from nfpde.bench.real.pendulums import double_pendulum, simple_pendulum
from nfpde.bench.real.servo import servo
from nfpde.bench.real.table import line
from nfpde.cli import app
from nfpde.errors import BadInput


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    """A servo that stands still for a second: too little to diagnose, said in words."""
    raw = tmp_path / "recordings" / "bam_xl330" / "raw"
    raw.mkdir(parents=True)
    entry = {"position": 0.1, "speed": 0.0, "goal_position": 0.1, "torque_enable": True}
    for gain in (400, 800):
        run = {"kp": gain, "trajectory": "rest", "entries": [{"timestamp": 0.005 * k, **entry} for k in range(201)]}
        (raw / f"{gain}.json").write_text(json.dumps(run))
    run["entries"][7]["torque_enable"] = False
    (raw / "free_fall.json").write_text(json.dumps(run))
    return tmp_path / "recordings"


def test_what_a_diagnosis_refuses_is_a_row(recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The reason stands in the table; a call that was stopped goes on, and leaves nothing behind."""
    out = tmp_path / "out"
    asked = ["bench", "real", str(recordings), "--only", "hobby servo", "--device", "cpu", "--out", str(out)]
    real = bench.diagnose_gap

    def stopped(model, data, **settings):
        monkeypatch.setattr(bench, "diagnose_gap", interrupted)
        return real(model, data, **settings)

    def interrupted(*args, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(bench, "diagnose_gap", stopped)
    CliRunner().invoke(app, asked)
    assert list(json.loads((out / "real.part.json").read_text())["parts"]) == ["hobby servo at gain 400"]
    monkeypatch.setattr(bench, "diagnose_gap", real)
    again = CliRunner().invoke(app, asked)
    assert again.exit_code == 0, again.output
    assert "going on from" in again.output
    assert sorted(p.name for p in out.iterdir()) == ["real.json", "real.md"]
    rows = json.loads((out / "real.json").read_text())["rows"]
    assert [row["name"] for row in rows] == ["hobby servo at gain 400", "hobby servo at gain 800"]
    for row in rows:
        assert (row["episodes"], row["rows"], row["control_dt"]) == (1, 101, 0.01)
        assert row["refused"]
        assert row["refused"] in (out / "real.md").read_text()


def test_folders_and_names_that_are_not_there(recordings: Path, tmp_path: Path):
    with pytest.raises(BadInput, match="has no folder 'double_pendulum'; give the folder that has one of each source"):
        bench.run(recordings, tmp_path)
    with pytest.raises(BadInput, match=r"no case begins with 'hexapod'; there are: double pendulum A\.0; "):
        bench.run(recordings, tmp_path, names=["hobby", "hexapod"])


def test_runs_with_the_torque_off_are_left_out(recordings: Path):
    """Only the runs of the gain that was asked for; stiff as the firmware's gain says."""
    model, data = servo(recordings / "bam_xl330", 800)
    assert [episode.name for episode in data] == ["rest"]
    assert data.control_dt == 0.01
    stiffness = model.actuator_gainprm[0, 0]
    assert stiffness == pytest.approx(0.4 * 7.4 / 3.5 * 800 * 4096 / (2 * np.pi) / (256 * 885))


def test_torques_of_both_layouts(tmp_path: Path):
    """Friction compensation is part of what the motors were told; runs that say nothing of it have one torque."""
    folder = tmp_path / "design_C.0"
    folder.mkdir()
    time = np.arange(600) * 0.002
    for name, columns in (
        ("a", ("pos1", "pos2", "vel1", "vel2", "tau1", "tau2")),
        ("b", ("pos_meas1", "pos_meas2", "vel_meas1", "vel_meas2", "tau_con1", "tau_con2", "tau_fric1", "tau_fric2")),
        ("friccomp", ("pos1",)),
    ):
        data = np.tile(np.arange(1.0, len(columns) + 1), (600, 1))
        np.savez(folder / name, time=time, data=data, columns=np.array(columns))
    model, data = double_pendulum(tmp_path, "C.0")
    assert [episode.name for episode in data] == ["a", "b"]
    np.testing.assert_allclose(data[0].ctrl[:-1], np.tile([5.0, 6.0], (len(data[0].ctrl) - 1, 1)))
    np.testing.assert_allclose(data[1].ctrl[:-1], np.tile([12.0, 14.0], (len(data[1].ctrl) - 1, 1)))
    # parallel axes: about the shoulder the published 0.0267, or what a point mass has if that is more
    assert model.body("upper").inertia[0] + 0.642 * 0.2**2 == pytest.approx(0.0267)
    assert model.body("lower").inertia[0] == pytest.approx(1e-4)


def test_pieces_between_gaps(tmp_path: Path):
    time = np.concatenate([np.arange(150) * 0.01, 3 + np.arange(200) * 0.01, 9 + np.arange(50) * 0.01])
    table = np.column_stack([time, np.sin(time), np.cos(time), 0 * time])
    (tmp_path / "sac").mkdir()
    np.savetxt(tmp_path / "sac" / "run.csv", table, delimiter=",", header="time,position,velocity,torque")
    _, data = simple_pendulum(tmp_path, "sac/run.csv")
    assert [episode.duration for episode in data] == [pytest.approx(1.49), pytest.approx(1.99)]


def test_a_row_says_value_unit_and_rivals():
    value = {"value": 0.0912, "low": 0.09, "high": 0.0931, "unit": "Nm", "at_bound": False}
    cause = {"effect": "coulomb_friction", "target": "elbow", "reading": "", "values": {"torque": value}}
    row = {
        "name": CASES[0].name,
        "known": CASES[0].known,
        "episodes": 4,
        "rows": 4004,
        "control_dt": 0.01,
        "verdict": "effects",
        "effects": [{**cause, "rivals": ["viscous_damping elbow"]}],
        "gap": {"after_effects": 0.0512, "noise_floor": 0.01},
        "distance": {"before": 0.5, "after_effects": 0.02},
        "million_steps": 3.14159,
    }
    assert line(row) == (
        "| double pendulum A.0 | 4 x 10 s | effects | coulomb_friction elbow or viscous_damping elbow: torque "
        f"0.0912 (0.09 to 0.0931) Nm | {CASES[0].known} | 1 to 0.051, 0.01 | 0.5 to 0.02 | 3.1 |"
    )
