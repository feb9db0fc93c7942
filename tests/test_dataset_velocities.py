"""Velocities from positions: parabolas exactly, MuJoCo's convention for rotations, and what has no velocity."""

import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from nfpde.cli import app
from nfpde.dataset import Episode, differentiate_episode, load_dataset
from nfpde.errors import BadDataset, BadInput

BALL_AND_ARM = """
<mujoco><worldbody>
  <body name="float"><freejoint name="root"/><geom size=".1"/>
    <body name="wrist"><joint name="ball" type="ball"/><geom size=".1"/>
      <body name="arm"><joint name="elbow"/><geom size=".1"/></body></body></body>
</worldbody></mujoco>"""


def uneven(rng: np.random.Generator, rows: int = 40) -> np.ndarray:
    return np.cumsum(rng.uniform(0.005, 0.03, rows))


def test_parabolas_are_exact_at_uneven_steps():
    """A parabola through three rows is what the positions are; the ends have the mean speed of one step."""
    rng = np.random.default_rng(0)
    time, (a, b) = uneven(rng), rng.normal(size=(2, 3))
    qpos = a * time[:, None] ** 2 + b * time[:, None]
    found = differentiate_episode(Episode("x", time, qpos, np.zeros((40, 0)), np.zeros((40, 1)), robot="r"))
    speed = 2 * a * time[:, None] + b
    np.testing.assert_allclose(found.qvel[1:-1], speed[1:-1], rtol=0, atol=1e-10)  # rounding over steps of 5 ms
    np.testing.assert_allclose(found.qvel[[0, -1]], [0.5 * (speed[0] + speed[1]), 0.5 * (speed[-2] + speed[-1])])
    assert (found.robot, found.nv) == ("r", 3)
    np.testing.assert_array_equal(found.qpos, qpos)


def test_rotations_are_those_of_mujoco():
    """Between two rows as mj_differentiatePos has it: linear in the world's frame, angular in the body's."""
    model, rng = mujoco.MjModel.from_xml_string(BALL_AND_ARM), np.random.default_rng(1)
    qpos, time = np.zeros((30, model.nq)), uneven(rng, 30)
    qpos[0, [3, 7]] = 1.0
    for k in range(29):
        qpos[k + 1] = qpos[k]
        mujoco.mj_integratePos(model, qpos[k + 1], rng.normal(size=model.nv), 0.1)
    found = differentiate_episode(Episode("x", time, qpos, np.zeros((30, 0)), np.zeros((30, 0))), quaternions=[3, 7])
    assert found.nv == model.nv
    rates = np.zeros((29, model.nv))
    for k, dt in enumerate(np.diff(time)):
        mujoco.mj_differentiatePos(model, rates[k], dt, qpos[k], qpos[k + 1])
    before, after = np.diff(time)[:-1, None], np.diff(time)[1:, None]
    wanted = (after * rates[:-1] + before * rates[1:]) / (before + after)
    np.testing.assert_allclose(found.qvel[1:-1], wanted, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.qvel[[0, -1]], rates[[0, -1]], rtol=0, atol=1e-9)


def test_a_spinning_body_has_one_speed():
    """A constant rotation about an axis of its own is constant, whatever way the quaternion's sign goes."""
    time = np.linspace(0.0, 4.0, 81)
    half = 0.5 * 3.0 * time
    quaternion = np.stack([np.cos(half), 0 * half, 0.6 * np.sin(half), 0.8 * np.sin(half)], axis=1)
    quaternion[30:] *= -1
    found = differentiate_episode(Episode("x", time, quaternion, np.zeros((81, 0)), np.zeros((81, 0))), [0])
    np.testing.assert_allclose(found.qvel, np.tile([0.0, 1.8, 2.4], (81, 1)), rtol=0, atol=1e-9)


@pytest.mark.parametrize("suffix", ["npz", "csv", "parquet"])
def test_files_without_velocities(tmp_path: Path, suffix: str):
    """Refused with what to do; read with `differentiate`, names kept, then resampled."""
    time = np.arange(60) * 0.01
    columns = {"episode": np.zeros(60, int), "time": time, "qpos_hip": np.sin(time), "qpos_knee": time**2}
    path = tmp_path / f"log.{suffix}"
    if suffix == "npz":
        qpos = np.column_stack([columns["qpos_hip"], columns["qpos_knee"]])
        arrays = {"episode": columns["episode"], "time": time, "qpos": qpos, "ctrl": np.zeros((60, 0))}
        np.savez(path, qpos_names=np.array(["hip", "knee"]), **arrays)
    elif suffix == "csv":
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        path.write_text("\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]))
    else:
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table(columns), path)
    with pytest.raises(BadDataset, match=r"missing .* qvel.*load_dataset\(\.\.\., differentiate=True\), .*--differen"):
        load_dataset(path)
    data = load_dataset(path, differentiate=True)
    assert data.column_names.qvel == ("hip", "knee")
    np.testing.assert_allclose(data[0].qvel[1:-1, 1], 2 * time[1:-1], rtol=0, atol=1e-12)
    coarse = load_dataset(path, differentiate=True, resample=0.05)
    np.testing.assert_allclose(coarse[0].qvel[1:-1, 1], 2 * coarse[0].time[1:-1], rtol=0, atol=1e-12)


def test_velocities_of_the_file_are_not_read(tmp_path: Path):
    """Recorded ones that are of no use make room, whatever is wrong with them."""
    rows = "".join(f"0,{0.1 * k},{0.3 * k},nan\n" for k in range(9))
    (tmp_path / "log.csv").write_text("episode,time,qpos_a,qvel_a\n" + rows)
    data = load_dataset(tmp_path / "log.csv", differentiate=True)
    np.testing.assert_allclose(data[0].qvel, 3.0)
    assert data.extra_columns == ("qvel_a",)


def test_no_difference_across_a_gap(tmp_path: Path):
    """Cut at its gaps first: no speed is made up of what moved in between."""
    time = np.concatenate([np.arange(20) * 0.01, 1 + np.arange(20) * 0.01])
    qpos = np.concatenate([2.0 * time[:20], 40 - 2.0 * time[20:]])[:, None]
    np.savez(tmp_path / "log.npz", episode=np.zeros(40, int), time=time, qpos=qpos, ctrl=np.zeros((40, 0)))
    data = load_dataset(tmp_path / "log.npz", differentiate=True, split_gaps=True)
    np.testing.assert_allclose([e.qvel for e in data], [np.full((20, 1), 2.0), np.full((20, 1), -2.0)])


@pytest.mark.parametrize("bad", [5, 0, 28])
def test_wrapped_angles_are_refused(bad: int):
    """A jump by a turn has no speed, in the middle or at an end; a wheel that is fast all the time has one."""
    time = np.arange(30) * 0.01
    angle = 0.1 * np.arange(30.0)
    angle[bad + 1 :] -= 2 * np.pi
    words = re.escape(f"episode 'x', row {bad + 1}, column qpos_0: ")
    with pytest.raises(BadDataset, match=words + r".* follows .*, 1 such jump\(s\).*np\.unwrap"):
        differentiate_episode(Episode("x", time, angle[:, None], np.zeros((30, 0)), np.zeros((30, 0))))
    wheel = 5.0 * np.arange(30.0)[:, None]
    found = differentiate_episode(Episode("x", time, wheel, np.zeros((30, 0)), np.zeros((30, 0))))
    np.testing.assert_allclose(found.qvel, 500.0)


def test_two_rows_and_bad_quaternions():
    two = Episode("x", [0.0, 0.5], [[1.0, 0, 0, 0], [1.0, 0, 0, 0.2]], np.zeros((2, 0)), np.zeros((2, 0)))
    np.testing.assert_allclose(differentiate_episode(two).qvel, [[0, 0, 0, 0.4]] * 2)
    with pytest.raises(BadInput, match=r"each takes 4 qpos columns from its first on, inside nq=4"):
        differentiate_episode(two, [1])
    zero = Episode("x", [0.0, 0.5], [[1.0, 0, 0, 0], [0.0, 0, 0, 0]], np.zeros((2, 0)), np.zeros((2, 0)))
    with pytest.raises(BadDataset, match="row 1, column qpos_0: the quaternion is zero"):
        differentiate_episode(zero, [0])
    with pytest.raises(BadInput, match="quaternions is given without resample or differentiate"):
        load_dataset("anything.npz", quaternions=[0])


def test_from_the_command_line(tmp_path: Path):
    """A pendulum whose recordings have no velocities: the mass of its bob is found from positions alone."""
    run = CliRunner()
    data = tmp_path / "data"
    done = run.invoke(app, ["collect", "pendulum", "--robots", "1", "--episodes", "6", "--out", str(data)])
    assert done.exit_code == 0, done.output
    with np.load(data / "data.npz") as file:
        np.savez(tmp_path / "positions.npz", **{k: file[k] for k in file.files if not k.startswith("qvel")})
    asked = ["fit", "pendulum", str(tmp_path / "positions.npz"), "--params", str(data / "parameters.toml")]
    asked += ["--device", "cpu", "--quiet", "--out", str(tmp_path / "fit")]
    refused = run.invoke(app, asked)
    assert refused.exit_code != 0
    assert "--differentiate" in str(refused.exception or refused.output)
    done = run.invoke(app, [*asked, "--differentiate"])
    assert done.exit_code == 0, done.output
    assert "qvel hinge: computed from positions" in done.output.replace("\n", " ")
    (found,) = json.loads((tmp_path / "fit" / "fit.json").read_text())["robots"]
    values = [row["value"] for row in found["parameters"].values()]
    truth = json.loads((data / "truth.json").read_text())["xi"][0]
    np.testing.assert_allclose(values, truth, rtol=1e-4)  # no noise: what is left is rounding over a whole episode
