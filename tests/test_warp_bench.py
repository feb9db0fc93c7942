"""The benchmark of losses on a device does what its table says; tried on Warp's CPU device."""

import json

import numpy as np
import pytest

from nfpde.bench import losses_warp
from nfpde.bench.estimation.calibration import CalibrationSettings, problem
from nfpde.bench.estimation.cell import facts_of_device
from nfpde.benchmarks import robot
from nfpde.errors import BadInput
from nfpde.estimation import TrajectoryConfig
from nfpde.sim.warp import WarpSimulator


def test_the_table_and_the_file(monkeypatch, tmp_path, capsys):
    """One row for each robot and size: every pair counted once, rates of the same run beside each other."""
    hopper = robot("hopper")
    monkeypatch.setattr(losses_warp, "ROBOTS", {"hopper": hopper})
    monkeypatch.setattr(losses_warp, "VECTORS", 4)
    monkeypatch.setattr(losses_warp, "TINY_SIZES", (4, 24))
    monkeypatch.setattr(losses_warp, "_starts", lambda *_, cold: {"warm": 1.0})
    calls = []
    original = WarpSimulator.losses
    monkeypatch.setattr(
        WarpSimulator,
        "losses",
        lambda self, xi, w, scale: calls.append(len(xi) * len(w)) or original(self, xi, w, scale),
    )
    losses_warp.run(True, tmp_path, "warp-cpu")
    facts = json.loads((tmp_path / "losses_warp-cpu_quick.json").read_text())
    assert [row["pairs"] for row in facts["rows"]] == [4, 24]
    assert set(calls) == {4, 24}
    for row in facts["rows"]:
        assert row["worlds_at_once"] == row["pairs"]
        assert row["share_of_bare"] == pytest.approx(row["evaluations_per_second"] / row["bare_per_second"])
        assert row["cpu_per_second"] > 0
        assert row["measured_bytes"] is None
    table = (tmp_path / "losses_warp-cpu_quick.md").read_text()
    assert "nfpde bench losses --device warp-cpu --quick" in table
    assert "hopper warm 1.0 s" in table
    assert table in capsys.readouterr().out


def test_other_devices_are_refused(tmp_path):
    """The table of the plain CPU is another command's."""
    with pytest.raises(BadInput, match="cuda or warp-cpu"):
        losses_warp.run(True, tmp_path, "cpu")


def test_a_problem_of_the_calibration_on_both_devices():
    """The same recordings fitted with either simulator: best values apart by a fraction of their standard deviation."""
    settings = CalibrationSettings(TrajectoryConfig(starts=2, steps=4, rounds=3), steps=30, samples=99)
    here, there = (problem("pendulum", False, settings, 0, device) for device in ("cpu", "warp-cpu"))
    assert here["true"] == there["true"]
    apart = np.abs(np.array(there["value"]) - here["value"])
    assert (apart < 0.05 * np.array(here["std"])).all()


def test_a_file_says_where_its_fits_were_simulated():
    """Nothing on the CPU, as in all files before; elsewhere the device and what it is."""
    body = robot("hopper")
    assert facts_of_device(body, "cpu") == {}
    assert facts_of_device(body, "warp-cpu")["device"].startswith("warp-cpu: MuJoCo Warp")
