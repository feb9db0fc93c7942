"""Recordings of real robots: jitter, gaps and repeated time stamps as loggers leave them."""

from pathlib import Path

import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode, load_dataset, resample_episode, save_dataset, split_episode_at_gaps
from nfpde.errors import BadDataset

REAL = Path(__file__).parents[2] / "shared" / "realdata"
ARM, PENDULUM = REAL / "so101_sage" / "so101_all.npz", REAL / "double_pendulum"


def arm_episodes():
    with np.load(ARM) as file:
        motions = sorted({name.split("/")[0] for name in file.files if "/" in name})
        return [Episode(m, *(file[f"{m}/{k}"] for k in ("t", "q", "v", "cmd")), robot="so101") for m in motions]


def pendulum_episode(path):
    with np.load(path) as file:
        columns = [c.replace("_meas", "") for c in file["columns"].tolist()]
        pos, vel = ([columns.index(f"{k}{i}") for i in (1, 2)] for k in ("pos", "vel"))
        torque = [columns.index(f"tau{i}" if f"tau{i}" in columns else f"tau_con{i}") for i in (1, 2)]
        data = file["data"]
        return Episode(path.stem, file["time"], data[:, pos], data[:, vel], data[:, torque], robot=path.parent.name)


@pytest.mark.skipif(not ARM.exists(), reason="the recordings are not here")
def test_so101_arm(tmp_path):
    """75 minutes of a real arm: jitter above 1 % is refused, resampling to 20 ms makes 50 even motions."""
    episodes = arm_episodes()
    with pytest.raises(
        BadDataset, match=r"episode 'actuator_bandwidth': .*uneven, from 0\.0200\d+ to 0\.0202\d+ s .*resample=0\.02\)"
    ):
        Dataset(episodes)
    data = Dataset([resample_episode(e, 0.02) for e in episodes])
    assert (len(data), data.nq, data.nu, data.control_dt) == (50, 6, 6, 0.02)
    assert data.nrow * 0.02 == pytest.approx(4515, rel=1e-3)  # the published total, seconds
    for old, new in zip(episodes, data, strict=True):
        for joint in range(6):  # rounding alone sets the two interpolations apart
            expected = np.interp(new.time, old.time, old.qpos[:, joint])
            np.testing.assert_allclose(new.qpos[:, joint], expected, rtol=0, atol=1e-12)
            held = np.concatenate([[0], np.cumsum(old.ctrl[:-1, joint] * np.diff(old.time))])
            lasting = np.diff(np.interp(new.time, old.time, held))  # each command acts until the next
            np.testing.assert_allclose(0.02 * new.ctrl[:-1, joint], lasting, rtol=0, atol=1e-7)  # clocks are rounded
    windows = data.windows(10, stride=5, history=6)
    assert np.isfinite(windows.state).all()
    small = data.subset(range(3))
    save_dataset(small, tmp_path / "arm.parquet")
    assert load_dataset(tmp_path / "arm.parquet").content_hash() == small.content_hash()


@pytest.mark.skipif(not PENDULUM.exists(), reason="the recordings are not here")
def test_double_pendulum_fleet():
    """Two builds of a real double pendulum: gaps and a repeated stamp are found; 2 ms resampling joins the rest."""
    paths = sorted(PENDULUM.glob("*/*.npz"))
    with pytest.raises(BadDataset, match=r"friccomp.*row \d+, column time: .* s follows .* s; time must increase"):
        [pendulum_episode(p) for p in paths]
    episodes = [pendulum_episode(p) for p in paths if "friccomp" not in p.name]
    with pytest.raises(BadDataset, match=r"about 1 row\(s\) are missing there \(2 such gap"):
        Dataset(episodes)
    pieces = [piece for e in episodes for piece in split_episode_at_gaps(e, max_gap=0.0055)]
    data = Dataset([resample_episode(e, 0.002, max_gap=0.0055) for e in pieces])
    assert data.robots == ["design_A.0", "design_C.0"]
    rest, out = data.split(0.5, seed=0)
    assert len(rest.robots) == len(out.robots) == 1
    lost = sum(e.duration for e in episodes) - sum(e.duration for e in data)
    assert 0 <= lost < 0.01 * sum(e.duration for e in episodes)
