"""Recordings of positions alone: what is made of velocities that nobody measured, and what is found all the same."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode, load_dataset
from nfpde.dataset.velocities import COMPUTED, differentiate_episode
from nfpde.gap import diagnose_gap
from nfpde.gap.brief import brief
from nfpde.gap.differences import WAYS, Differences
from nfpde.gap.grain import Encoders
from nfpde.gap.natural import measured
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.sensors import _with_velocities, sensor_noise
from tests.gap_systems import nominal, record

BALL = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="ball" pos="0 0 3"><freejoint/>
  <geom type="ellipsoid" size=".1 .05 .03" mass=".3"/></body></worldbody></mujoco>"""


def backward(qpos):
    return np.concatenate([qpos[1:2] - qpos[:1], np.diff(qpos, axis=0)]) / 0.01


def forward(qpos):
    return np.concatenate([np.diff(qpos, axis=0), qpos[-1:] - qpos[-2:-1]]) / 0.01


def central(qpos):
    return np.gradient(qpos, 0.01, axis=0)


BY = {"backward": backward, "forward": forward, "central": central}


def computed(data, way="central", columns=(0, 1)):
    """Recordings whose velocities are differences of the positions, as far as columns are given."""
    out = []
    for e in data:
        qvel = e.qvel.copy()
        qvel[:, list(columns)] = BY[way](e.qpos)[:, list(columns)]
        out.append(replace(e, qvel=qvel))
    return Dataset(out)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_velocities_that_nobody_measured_are_told(noise):
    """Differences of noisy positions, whichever way, in double and in single precision; measured speeds are none."""
    model, data = nominal(), record(noise=noise)
    assert Differences.of(model, data).said == ""
    assert not Differences.of(model, data).weights.any()
    for way in WAYS:
        some = computed(data, way, [1])
        short = Dataset([replace(e, qvel=e.qvel.astype(np.float32).astype(float)) for e in some])
        for one in (some, short):
            found = Differences.of(model, one)
            assert found.said == f"elbow ({way})"
            assert found.weights.tolist() == [[0, 0, 0], list(WAYS[way])]


def test_what_a_data_set_says_is_believed():
    """Where velocities were computed before the recordings were resampled, say, no digits tell."""
    data = record(noise=1e-3)
    data = replace(data, metadata=replace(data.metadata, conventions=COMPUTED))
    found = Differences.of(nominal(), data)
    assert found.said == "shoulder (central) and elbow (central)"
    assert (found.weights == WAYS["central"]).all()


def test_single_steps_of_a_simulation_measure_speeds():
    """MuJoCo moves positions by the speeds of the next row: these are no differences that anybody took."""
    model = nominal()
    model.opt.timestep = 0.01
    assert Differences.of(model, computed(record(), "backward")).said == ""
    for way in ("central", "forward"):  # as none of its integrators does
        assert Differences.of(model, computed(record(), way)).said == f"shoulder ({way}) and elbow ({way})"


@pytest.mark.parametrize("way", WAYS)
def test_noise_of_positions_reaches_velocities(way):
    """Slopes by the noise of positions and of velocities of six rows, against noise put on the rows themselves."""
    rng, nv = np.random.default_rng(3), 2
    weights = np.array([WAYS[way], (0.0, 0.0, 0.0)]) / 0.01
    slopes = rng.normal(size=(4, 5, 2 * nv, 2 * nv))
    position, velocity = rng.normal(size=(2, 6, nv))
    error = np.zeros((4, 2 * nv))
    for row in range(4):  # the second to the fifth of the six
        around = position[row : row + 3]
        error[row] = [*around[1], *(velocity[row + 1] + (weights.T * around).sum(0))]
    expected = np.einsum("rnij,rj->ni", slopes, error)
    wide = _with_velocities(slopes, weights)
    noise = np.concatenate([position, velocity], axis=1)
    noise[[0, 5], nv:] = 7.0  # of the first and the last row only positions count
    assert np.einsum("rnij,rj->ni", wide, noise) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_noise_of_positions_is_found(way, noise):
    """It comes back to a fifth, and velocities count as at least as wrong as they are."""
    data, exact = record(noise=noise), record()
    apart = computed(data, way)
    replay, weights = Replay(nominal(), None, []), np.tile(WAYS[way], (2, 1))
    rows = apart.windows(1, first=1)
    sigma = sensor_noise(replay, np.zeros(0), rows, Encoders.of([rows.start], weights))
    assert sigma[:2] == pytest.approx(noise * np.array([0.5, 0.8]), rel=0.2)
    wrong = np.concatenate([(a.qvel - b.qvel)[1:-1] for a, b in zip(apart, exact, strict=True)])
    size = np.sqrt((wrong**2).mean(0))
    assert (sigma[2:] > 0.9 * size).all()
    assert (sigma[2:] < 3 * size).all()


def thrown(rows=120, noise=0.0):
    """A ball that tumbles, its positions recorded with noise."""
    model = mujoco.MjModel.from_xml_string(BALL)
    out, rng = [], np.random.default_rng(8)
    for number in range(4):
        data = mujoco.MjData(model)
        data.qvel[:] = rng.normal(size=6) * [1, 1, 1, 4, 4, 4]
        qpos = np.empty((rows, 7))
        for row in range(rows):
            qpos[row] = data.qpos
            mujoco.mj_step(model, data, 5)
        turned = np.empty(7)
        for row in range(rows):
            turned[:] = qpos[row]
            mujoco.mj_integratePos(model, turned, noise * rng.normal(size=6), 1.0)
            qpos[row] = turned
        episode = Episode(str(number), 0.01 * np.arange(rows), qpos, np.zeros((rows, 6)), np.zeros((rows, 0)))
        out.append(differentiate_episode(episode, [3]))
    data = Dataset(out)
    return model, replace(data, metadata=replace(data.metadata, conventions=COMPUTED))


def test_sensors_of_positions_alone_record_their_differences():
    """Made recordings have velocities that are what `differentiate_episode` makes of their own positions."""
    model, data = thrown(rows=30)
    replay = Replay(model, None, [])
    windows = data.windows(29)
    weights, rng = np.tile(WAYS["central"], (6, 1)), np.random.default_rng(4)
    made = measured(replay, windows, np.full(12, 1e-3), windows, Encoders.of([windows.start], weights), rng)
    for state in made.state:
        again = differentiate_episode(
            Episode("0", 0.01 * np.arange(30), state[:, :7], np.zeros((30, 6)), np.zeros((30, 0))), [3]
        )
        assert state[1:-1, 7:] == pytest.approx(again.qvel[1:-1], rel=1e-9, abs=1e-9)


def test_windows_begin_where_velocities_are_known():
    """None in the first row of an episode, where they are those of half a step later; positions alone count."""
    data = record()
    weights = np.tile(WAYS["central"], (2, 1))
    cut = cut_recordings(computed(data), 0, 0, 100, computed=weights)
    assert min(half.row.min() for half in (cut.fit, cut.held, cut.rows)) == 1
    assert cut.channels == len(cut.horizons)
    plain = cut_recordings(data, 0, 0, 100, computed=np.zeros((2, 3)))
    assert plain.channels is None
    assert min(half.row.min() for half in (plain.fit, plain.held)) == 0
    # one step tells the velocity that it begins with, and nothing else
    assert [len(b.horizons) for b in brief(plain)] == [1, 2, 3]
    assert [len(b.horizons) for b in brief(cut)] == [2, 3]


@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_a_sound_robot_that_logs_positions_alone_has_no_gap(noise):
    """What velocities from differences miss is no fault of the robot."""
    report = diagnose_gap(nominal(), computed(record(noise=noise)))
    assert report.verdict == "no_gap"
    assert "Nobody measured the velocities of shoulder (central) and elbow (central)" in report.summary[-1]


def test_a_ball_tracked_by_cameras_has_no_gap():
    """Poses alone, quaternions among them."""
    model, data = thrown(noise=1e-4)
    assert diagnose_gap(model, data).verdict == "no_gap"


@pytest.mark.parametrize("way", WAYS)
def test_a_fault_is_found_by_positions_alone(way):
    """Damping that is eight times as strong, whichever way velocities were computed, to a few percent."""
    data = computed(record(lambda m: m.dof_damping.__setitem__(1, 0.4), noise=3e-4), way)
    report = diagnose_gap(nominal(), data)
    assert report.verdict == "effects"
    most = report.effects[0]  # a second effect of next to no size may be named beside it
    assert (most.effect, most.target) == ("viscous_damping", "elbow")
    (value,) = most.parameters.values()
    assert value.value == pytest.approx(0.35, rel=0.03)
    assert report.gap.after_effects < 1.5 * report.gap.noise_floor


def test_a_file_without_velocities_is_diagnosed(tmp_path):
    """As `nfpde diagnose --differentiate` reads it."""
    rows = ["episode,time,qpos_0,qpos_1,ctrl_0,ctrl_1"]
    for e in record(episodes=4, noise=1e-4):
        rows += [
            ",".join([e.name, *(f"{x:.9g}" for x in (t, *q, *u))])
            for t, q, u in zip(e.time, e.qpos, e.ctrl, strict=True)
        ]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    data = load_dataset(tmp_path / "log.csv", differentiate=True)
    assert diagnose_gap(nominal(), data).verdict == "no_gap"
