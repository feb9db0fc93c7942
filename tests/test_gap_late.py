"""Speeds that a filter made late: told from what faults and commands do, and left out."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.gap import diagnose_gap
from nfpde.gap.late import late_speeds
from nfpde.gap.replay import Replay
from tests.gap_systems import nominal, record

LET, LAG = 0.4, 5.0 * (0.6 / 0.4 + 0.5)
"""What the filter lets through in a physics step of 5 ms, and how late speeds are then [ms]: the mean age of what comes
out, and half a step, as MuJoCo moves positions by the speeds at its end."""

SERVOS = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body pos="0 0 1">
  <joint name="pan" axis="0 0 1" damping=".1"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/>
  <body pos=".3 0 0"><joint name="tilt" axis="0 1 0" damping=".1"/>
  <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5"/></body></body></worldbody>
<actuator><velocity joint="pan" kv="{kv}"/><velocity joint="tilt" kv="{kv}"/></actuator></mujoco>"""


def late(data, model=None):
    model = nominal() if model is None else model
    return late_speeds(Replay(model, None, []), data, np.zeros(0))


def obeying(kv, rows=120, seed=0):
    """Episodes of an arm whose speed servos get a new command every 50 ms, and reach it well before the next."""
    model, rng, out = mujoco.MjModel.from_xml_string(SERVOS.format(kv=kv)), np.random.default_rng(seed), []
    for number in range(6):
        data, ctrl = mujoco.MjData(model), rng.normal(size=(rows, 2))
        qpos, qvel = np.empty((rows, 2)), np.empty((rows, 2))
        for row in range(rows):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            mujoco.mj_step(model, data, 25)
        out.append(Episode(str(number), 0.05 * np.arange(rows), qpos, qvel, ctrl))
    return Dataset(out)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_filter_is_found_and_its_lag_named(noise):
    """Behind the positions by the filter's mean age, to a tenth."""
    found = re.fullmatch(r"([\d.]+)(?: to ([\d.]+))? ms at shoulder and elbow", late(record(noise=noise, let=LET)))
    assert found is not None
    assert [float(x) for x in found.groups() if x] == pytest.approx([LAG] * (2 - found.groups().count(None)), rel=0.1)


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
@pytest.mark.parametrize(
    "fault",
    [
        lambda model: None,
        lambda model: model.dof_damping.__setitem__(1, 0.8),
        lambda model: model.dof_frictionloss.__setitem__(slice(None), 0.3),
        lambda model: model.actuator_gear.__setitem__((0, 0), 0.5),
        lambda model: model.body_mass.__setitem__(2, 3.0),
    ],
)
def test_speeds_that_were_measured_are_not_late(noise, fault):
    """Whatever the robot lacks, with and without noise."""
    assert late(record(fault, noise=noise)) == ""


def test_rows_are_looked_at_without_the_history_of_all(monkeypatch):
    """At 1 kHz a delay of 0.2 s makes two hundred times as much of it as there are recordings."""
    cut, windows = [], Dataset.windows

    def counted(*args, **kwargs):
        found = windows(*args, **kwargs)
        cut.append((len(found), found.history.shape[1]))
        return found

    monkeypatch.setattr(Dataset, "windows", counted)
    monkeypatch.setattr("nfpde.gap.late.MOST", 500)
    delay = effect("actuation_delay", "*", delay=(0.0, 0.2))
    late_speeds(Replay(nominal(), None, [delay]), record(), np.zeros(1))
    assert max(count for count, history in cut if history) == 500
    assert max(count for count, history in cut) > 500


def test_one_filtered_speed_is_not_enough():
    """What is at one joint alone may be a fault of that joint."""
    data, filtered = record(), record(let=LET)
    both = [replace(e, qvel=np.stack([e.qvel[:, 0], f.qvel[:, 1]], 1)) for e, f in zip(data, filtered, strict=True)]
    assert late(Dataset(both)) == ""


@pytest.mark.parametrize("kv", [1.0, 2.0, 4.0])
def test_what_coarse_commands_do_is_no_filter(kv):
    """Speeds that reach each command within its step run behind the positions: the model's do so, whatever its gain."""
    data = obeying(kv)
    ahead, change = (
        np.concatenate([(x[2:] - x[:-2]) / 0.1 - y for x, y in pairs])
        for pairs in (
            [(e.qpos, e.qvel[1:-1]) for e in data],
            [(e.qvel, np.zeros(2)) for e in data],
        )
    )
    assert (ahead * change).sum() / (change**2).sum() > 0.005
    assert late(data, mujoco.MjModel.from_xml_string(SERVOS.format(kv=2.0))) == ""


def test_too_little_to_tell():
    """Two rows, or a few, say nothing."""
    short = Dataset([replace(e, **{n: getattr(e, n)[:4] for n in ("time", "qpos", "qvel", "ctrl")}) for e in record()])
    assert late(short) == ""
    assert (
        late(Dataset([replace(e, **{n: getattr(e, n)[:2] for n in ("time", "qpos", "qvel", "ctrl")}) for e in short]))
        == ""
    )


def test_a_sound_robot_with_filtered_speeds_has_no_gap():
    """Its model would be wrong from the first step on; the report says what was left out."""
    report = diagnose_gap(nominal(), record(noise=1e-4, let=LET))
    assert report.verdict == "no_gap"
    assert re.search(r"run behind the positions.*ms at shoulder and elbow\. They were left out\.", report.summary[-1])


def test_a_fault_is_found_beside_a_filter():
    """Damping that is eight times as strong, to a few percent, down to the noise."""
    report = diagnose_gap(nominal(), record(lambda m: m.dof_damping.__setitem__(1, 0.4), noise=1e-4, let=LET))
    assert report.verdict == "effects"
    most = report.effects[0]
    assert (most.effect, most.target) == ("viscous_damping", "elbow")
    assert most.parameters["damping"].value == pytest.approx(0.35, rel=0.03)
    assert report.gap.after_effects < 1.5 * report.gap.noise_floor
