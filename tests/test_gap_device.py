"""The diagnosis on Warp's kernels: replays that agree with double precision, and devices refused by name."""

import numpy as np
import pytest
from typer.testing import CliRunner

from nfpde.cli import app
from nfpde.dataset import save_dataset
from nfpde.effects import effect
from nfpde.errors import BadInput
from nfpde.gap import diagnose_gap
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from tests.device import WARP
from tests.gap_systems import ARM, nominal, record


def test_replays_agree_with_double_precision():
    """With an effect and a force on each joint, residuals of both simulators differ by single precision only."""
    data = record(episodes=3, rows=150)
    cut = cut_recordings(data, 0, 0, 20)
    force = np.array([[0.0, 0.0], [0.3, 0.0], [0.0, -0.4]])
    xi = np.array([[0.0], [0.1], [0.2]])
    there = [
        Replay(nominal(), None, [effect("coulomb_friction", "elbow", torque=(0.0, 1.0))], device=device).residuals(
            xi, cut.fit, cut.horizons, force
        )
        for device in ("cpu", WARP)
    ]
    moved = there[0] - there[0][:1]
    # both rows with a force move the arm, each in its own way
    assert np.abs(moved[1]).max() > 0.05
    assert np.abs(moved[2]).max() > 0.05
    np.testing.assert_allclose(there[1], there[0], atol=1e-4 * np.abs(moved).max())


def test_a_device_without_hardware_or_name_is_refused(tmp_path):
    """The text lists the devices; nothing falls back silently; the command line says the same and ends with 2."""
    data = record(episodes=2, rows=150)
    with pytest.raises(BadInput, match="no device is called 'tpu'; there are: auto, cpu, cuda, warp-cpu"):
        diagnose_gap(nominal(), data, device="tpu")  # pyright: ignore[reportArgumentType]
    (tmp_path / "arm.xml").write_text(ARM)
    save_dataset(data, tmp_path / "data.npz")
    files = [str(tmp_path / "arm.xml"), str(tmp_path / "data.npz"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, ["diagnose", *files, "--device", "tpu"])
    assert result.exit_code == 2
    assert "warp-cpu" in result.output


@pytest.mark.slow
def test_the_same_cause_on_warp():
    """A whole diagnosis in single precision names the friction with the value of double precision."""
    data = record(lambda m: setattr(m, "dof_frictionloss", [0.0, 0.2]), noise=1e-3)
    found = [diagnose_gap(nominal(), data, windows=60, device=device) for device in ("cpu", WARP)]
    causes = [f.effects[0] for f in found]
    assert [(c.effect, c.target) for c in causes] == [("coulomb_friction", "elbow")] * 2
    torques = [c.parameters["torque"] for c in causes]
    assert torques[1].value == pytest.approx(torques[0].value, abs=0.2 * (torques[0].high - torques[0].low))
    assert [f.device.split(":")[0] for f in found] == ["cpu", WARP]
