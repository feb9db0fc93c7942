"""Any two joints may be swapped in the recordings."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.errors import BadDataset
from nfpde.gap import checks
from tests.test_gap_checks import checked


def rack(count=13, rows=120):
    """Pendulums of many lengths beside each other, each driven in its own way; recorded on their model."""
    bodies = "".join(
        f'<body pos="0 {i} 0"><joint name="j{i}" axis="0 1 0" damping=".1"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 -{0.3 + 0.04 * (5 * i % 13)}" size=".02"/></body>'
        for i in range(count)
    )
    motors = "".join(f'<motor joint="j{i}"/>' for i in range(count))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.005"/><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>'
    )
    out = []
    for number in range(4):
        data = mujoco.MjData(model)
        rates = np.random.default_rng(number).uniform(0.5, 2.0, count)
        ctrl = 4 * np.sin(2 * np.pi * 0.01 * np.outer(np.arange(rows), rates))
        qpos, qvel = np.empty((2, rows, count))
        for row in range(rows):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            mujoco.mj_step(model, data, 2)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, ctrl))
    return model, Dataset(out)


def test_any_two_joints_of_many_may_be_swapped(monkeypatch):
    """All 78 pairs of 13 joints, the last as well as the first; a few windows tell which are looked at on all."""
    model, data = rack()
    checked(model, data)
    looks = []
    error = checks._error
    monkeypatch.setattr(
        checks, "_error", lambda replay, xi, windows: looks.append(len(windows)) or error(replay, xi, windows)
    )
    order = [*range(11), 12, 11]
    wrong = [Episode(e.name, e.time, e.qpos[:, order], e.qvel[:, order], e.ctrl) for e in data]
    with pytest.raises(BadDataset, match="j11 and j12 look swapped in qpos and qvel"):
        checked(model, Dataset(wrong))
    mistakes_made = 3 * (13 + 78)
    assert sum(n < max(looks) for n in looks) == mistakes_made
    assert sum(n == max(looks) for n in looks) < mistakes_made / 2
