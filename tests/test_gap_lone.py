"""Windows that stand alone far beyond noise: which they are, what is said, and what is shown."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode, Windows
from nfpde.gap import Level, diagnose_gap
from nfpde.gap.lone import lone_windows, spoken
from nfpde.gap.words import _first

BLOCK = np.arange(100) // 5


@pytest.mark.parametrize("far", [[], [40], [40, 41, 77]])
def test_windows_far_beyond_noise_are_those(far):
    """None where noise gives as much; neighbours too, and the largest first."""
    rng = np.random.default_rng(0)
    gap, noise = rng.random(100), rng.random(1200)
    gap[far] = [50.0 + i for i in range(len(far))]
    assert lone_windows(gap, noise, BLOCK).tolist() == far[::-1]


def test_windows_that_are_unlikely_together_are_all_named():
    """Ten at one and a half times the largest draw: each alone may be noise."""
    rng = np.random.default_rng(1)
    gap, noise = 0.5 * rng.random(100), np.append(rng.random(1199), 1.0)
    gap[::10] = 1.5
    assert sorted(lone_windows(gap, noise, BLOCK).tolist()) == list(range(0, 100, 10))


def windows_at(episode, row, horizon=4):
    """Windows of these rows."""
    n = len(row)
    state, ctrl = np.zeros((n, horizon + 1, 2)), np.zeros((n, horizon, 1))
    return Windows(state, ctrl, np.empty((n, 0, 1)), 0.01, 1, 1, np.array(episode), np.array(row))


def test_places_are_episodes_and_rows():
    """Windows one after the other are one place, in whatever order they come; many places are cut short."""
    windows = windows_at([1, 0, 1, 1], [15, 30, 10, 40])
    assert spoken(windows, ["walk", "turn"]) == (
        "episode walk, rows 30 to 34; episode turn, rows 10 to 19; episode turn, rows 40 to 44"
    )
    many = spoken(windows_at([0] * 9, [20 * i for i in range(9)]), ["walk"])
    assert many.endswith("; and 3 more places")


def test_a_mean_within_noise_is_no_contradiction():
    """That 100 % is left and noise gives 104 % says nothing; where the windows are does."""
    within, beyond = Level(1.0, 1.0, 1.0, 1.0432), Level(1.0, 1.0, 1.0, 0.0023)
    said = _first("unexplained", within, (2, "episode 1, rows 57 to 61; ..."))
    assert said.endswith("the mean is within noise, but 2 windows are far beyond it: episode 1, rows 57 to 61; ....")
    assert "100" not in said
    said = _first("unexplained", beyond, (1, "episode 1, rows 57 to 61"))
    assert "100.0% of it is left; sensor noise alone gives 0.23%; 1 window is far beyond it: episode 1" in said
    assert "window" not in _first("unexplained", beyond, (0, ""))


HINGE = """
<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="hinge" axis="0 1 0" damping=".1"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1"/>
</body></worldbody><actuator><motor name="m" joint="hinge"/></actuator></mujoco>
"""
KNOCKS = (143, 231, 322)


def knocked(model, episode, rows=500, noise=1e-3, seed=5):
    """Two episodes of a pendulum, one of which something knocks at some rows."""
    rng, out = np.random.default_rng(seed), []
    for n in range(2):
        data, time = mujoco.MjData(model), 0.01 * np.arange(rows)
        data.qpos[:] = 0.5 * rng.normal()
        rate, phase = rng.uniform(0.3, 2, 4), rng.uniform(0, 6, 4)
        ctrl = np.sin(2 * np.pi * rate * time[:, None] + phase).sum(1)[:, None]
        qpos, qvel = np.empty((rows, 1)), np.empty((rows, 1))
        for row in range(rows):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            for _ in range(2):
                data.qfrc_applied[0] = 20.0 * (n == episode and row in KNOCKS)
                mujoco.mj_step(model, data)
        qpos += noise * rng.normal(size=qpos.shape)
        qvel += 5 * noise * rng.normal(size=qvel.shape)
        out.append(Episode(f"take {n}", time, qpos, qvel, ctrl))
    return Dataset(out)


def test_knocks_in_the_half_that_was_fitted_are_named_and_shown():
    """The held-out half shows nothing of them: no share of a force, and traces of the other half."""
    model = mujoco.MjModel.from_xml_string(HINGE)
    found = diagnose_gap(model, knocked(model, 1), windows=160, nthread=1, device="cpu")
    assert found.held_out_episodes == ["take 0"] or found.held_out_episodes == ("take 0",)
    assert found.verdict == "unexplained"
    assert "the mean is within noise, but" in found.summary[0]
    told = [t for t in found.traces if t.episode == "take 1"]
    assert told
    for trace in told:
        rows = np.round(trace.time / 0.01).astype(int)
        assert any(k in rows for k in KNOCKS)
        assert f"rows {rows[0]} to {rows[-1]}" in found.summary[0]
    assert found.residual_force is not None
    assert found.residual_force.share == 0.0
