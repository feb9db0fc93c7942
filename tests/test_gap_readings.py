"""What readings say about themselves: broken ones are refused by name, noisy, grainy and struck ones are not."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode, resample_episode
from nfpde.errors import BadDataset
from nfpde.gap.checks import check_readings
from tests.gap_systems import nominal, record

DEGREES = 180 / np.pi

WHEEL = """
<mujoco><option timestep="0.005"/><worldbody><body><joint name="wheel" axis="0 0 1" damping=".01"/>
  <geom type="cylinder" size=".1 .02" mass="1"/></body></worldbody>
<actuator><motor joint="wheel"/></actuator></mujoco>"""

STRUCK = """
<mujoco><option timestep="0.001"/>
<worldbody><geom type="plane" size="5 5 .1" solref="0.004 0.2"/>
  <body pos="0 0 .6"><joint name="shoulder" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1"/>
    <body pos=".3 0 0"><joint name="elbow" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".4"/>
      <body pos=".3 0 0"><joint name="wrist" axis="0 1 0" range="-.5 .5" limited="true" solreflimit="0.004 0.2"/>
        <geom type="capsule" fromto="0 0 0 .15 0 0" size=".01" mass=".05"/></body></body></body>
  <body name="ball" pos="1 0 .5"><freejoint name="ball"/><geom size=".05" mass=".1" solref="0.004 0.1"/></body>
</worldbody></mujoco>"""


def altered(data, change):
    """The same recordings with every episode's qpos and qvel changed in place."""
    out = []
    for e in data:
        qpos, qvel = e.qpos.copy(), e.qvel.copy()
        change(qpos, qvel)
        out.append(Episode(e.name, e.time, qpos, qvel, e.ctrl))
    return Dataset(out)


def spins(rows=400, noise=0.0):
    """A wheel that turns dozens of times, one way and back."""
    model = mujoco.MjModel.from_xml_string(WHEEL)
    data, rng, out = mujoco.MjData(model), np.random.default_rng(0), []
    for number in range(3):
        mujoco.mj_resetData(model, data)
        qpos, qvel, ctrl = np.empty((rows, 1)), np.empty((rows, 1)), np.empty((rows, 1))
        for row in range(rows):
            ctrl[row] = 0.5 * np.sin(0.01 * row * (2 + number))
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            mujoco.mj_step(model, data, 2)
        qpos += noise * rng.normal(size=qpos.shape)
        qvel += 5 * noise * rng.normal(size=qvel.shape)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, ctrl))
    return model, Dataset(out)


def wrapped(qpos, qvel):
    qpos[:] = (qpos + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_wrapped_angles_are_counted(noise):
    """Every jump is counted, and the first is where the words say; the same turns unwrapped pass."""
    model, data = spins(noise=noise)
    assert np.ptp(data.episodes[0].qpos) > 8 * np.pi
    check_readings(model, data)
    wrong = altered(data, wrapped)
    jumps = [np.flatnonzero(np.abs(np.diff(e.qpos[:, 0])) > np.pi) + 1 for e in wrong]
    count = sum(len(j) for j in jumps)
    with pytest.raises(BadDataset, match=rf"wheel: .* {count} time\(s\), first in episode '0' at row {jumps[0][0]},"):
        check_readings(model, wrong)


def test_wrapped_angles_are_found_after_resampling():
    """A jump that resampling has spread over two rows is still one; the words say what to do before it."""
    model, data = spins()
    uneven = [resample_episode(e, 0.0125) for e in altered(data, wrapped)]
    with pytest.raises(BadDataset, match=r"wheel: .*np\.unwrap in every episode, before any resampling"):
        check_readings(model, Dataset(uneven))


def swap_positions(qpos, qvel):
    qpos[:] = qpos[:, ::-1].copy()


def position_in_degrees(qpos, qvel):
    qpos[:, 1] *= DEGREES


def speeds_in_degrees(qpos, qvel):
    qvel *= DEGREES


def against(qpos, qvel):
    qvel[:, 0] *= -1


@pytest.mark.parametrize("noise", [0.0, 2e-3])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (swap_positions, "shoulder and elbow stand in different columns of qpos and qvel"),
        (position_in_degrees, "^elbow: the qpos looks recorded in degrees: qpos changes 57.3 times"),
        (speeds_in_degrees, "^shoulder and elbow: the qvel look recorded in degrees: qpos changes 0.0175 times"),
        (against, "^shoulder: its qvel runs against the change of its qpos"),
    ],
)
def test_speeds_that_are_not_the_change_of_positions(change, words, noise):
    """Columns swapped, degrees and signs in one of qpos and qvel show without a simulation."""
    with pytest.raises(BadDataset, match=words):
        check_readings(nominal(), altered(record(noise=noise), change))


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize(("group", "size"), [("qpos", 1.0), ("qpos", -0.5), ("qvel", 100.0), ("qvel", -100.0)])
def test_spikes_are_counted(group, size, noise):
    """Two single readings far off in one column are named with their column, count, episode and row."""

    def spiked(qpos, qvel):
        (qpos if group == "qpos" else qvel)[[40, 200], 1] += size

    words = rf"elbow: 12 reading\(s\) of its {group} are spikes, first in episode '0' at row 40 \("
    with pytest.raises(BadDataset, match=words):
        check_readings(nominal(), altered(record(noise=noise), spiked))


def test_a_spike_beside_blows_is_found():
    """Where blows shake the joints, a reading that no blow explains is still named."""
    model, data = struck()

    def spiked(qpos, qvel):
        qpos[50, 1] += 1.5

    with pytest.raises(BadDataset, match=r"elbow: 4 reading\(s\) of its qpos are spikes"):
        check_readings(model, altered(data, spiked))


def struck(noise=0.0, rows=200):
    """Three links that fall on a hard floor and their stops, and a ball that bounces beside them."""
    model = mujoco.MjModel.from_xml_string(STRUCK)
    data, rng, out = mujoco.MjData(model), np.random.default_rng(1), []
    for number in range(4):
        mujoco.mj_resetData(model, data)
        data.qpos[:3] = rng.uniform(-0.4, 0.4, 3)
        qpos, qvel = np.empty((rows, model.nq)), np.empty((rows, model.nv))
        for row in range(rows):
            qpos[row], qvel[row] = data.qpos, data.qvel
            mujoco.mj_step(model, data, 10)
        qpos[:, :6] += noise * rng.normal(size=(rows, 6))
        qvel += 5 * noise * rng.normal(size=qvel.shape)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, np.zeros((rows, 0))))
    return model, Dataset(out)


@pytest.mark.parametrize("noise", [0.0, 1e-4, 3e-3])
def test_blows_are_no_spikes(noise):
    """Links that hit a floor and their stops, and a ball that bounces, are sound recordings."""
    model, data = struck(noise)
    assert np.abs(np.diff(data.episodes[0].qvel[:, :3], axis=0)).max() > 3.0  # [rad/s]: they do get hit
    check_readings(model, data)


def grainy(qpos, qvel):
    grain = 2 * np.pi / 4096
    qpos[:] = grain * np.round(qpos / grain)
    qvel[:] = 0.05 * np.round(qvel / 0.05)


def long_tailed(qpos, qvel):
    rng = np.random.default_rng(3)
    qpos += 1e-3 * rng.laplace(size=qpos.shape)
    qvel += 1e-2 * rng.laplace(size=qvel.shape)


def louder_in_motion(qpos, qvel):
    qvel += 0.3 * np.abs(qvel) * np.random.default_rng(4).normal(size=qvel.shape)


def mostly_at_rest(qpos, qvel):
    """Rests for most of the time, an encoder toggling between two steps, then moves."""
    rng = np.random.default_rng(5)
    qpos[:220], qvel[:220] = 1e-3 * rng.integers(0, 2, (220, 2)), 0.0
    qpos[220:] += 0.0 - qpos[220]


def elbow_at_rest(qpos, qvel):
    """Never moves; its encoder toggles between two steps, and its speed reads zero."""
    qpos[:, 1], qvel[:, 1] = 1e-3 * np.random.default_rng(6).integers(0, 2, len(qpos)), 0.0


def rarely_toggling(qpos, qvel):
    """Rests between two steps of its encoder, and shows the other one now and then for a row."""
    rng = np.random.default_rng(7)
    qpos[:, 1], qvel[:, 1] = 1e-3 * (rng.random(len(qpos)) < 0.02), 1e-6 * rng.normal(size=len(qvel))


def shaken_at_times(qpos, qvel):
    """Quiet but for forty rows, in which the reading shakes ten thousand times as much."""
    rng = np.random.default_rng(8)
    qpos[:, 1], qvel[:, 1] = 1e-6 * rng.normal(size=len(qpos)), 1e-6 * rng.normal(size=len(qvel))
    qpos[100:140, 1] += 1e-2 * rng.normal(size=40)


def late_speeds(qpos, qvel):
    """A filter that lags by five rows."""
    for row in range(1, len(qvel)):
        qvel[row] = qvel[row - 1] + 0.2 * (qvel[row] - qvel[row - 1])


@pytest.mark.parametrize(
    "change",
    [
        grainy,
        long_tailed,
        louder_in_motion,
        mostly_at_rest,
        elbow_at_rest,
        rarely_toggling,
        shaken_at_times,
        late_speeds,
    ],
    ids=lambda c: c.__name__,
)
def test_poor_sensors_are_sound(change):
    """Grain, long tails, noise that comes with the motion, rest and filters are what sensors have."""
    check_readings(nominal(), altered(record(), change))


@pytest.mark.parametrize("rows", [2, 3, 8])
def test_short_episodes_are_sound(rows):
    """Many episodes of a few rows are compared inside episodes only."""
    cut = [
        Episode(f"{e.name} {k}", e.time[k : k + rows], e.qpos[k : k + rows], e.qvel[k : k + rows], e.ctrl[k : k + rows])
        for e in record(noise=1e-3)
        for k in range(0, 240, rows)
    ]
    check_readings(nominal(), Dataset(cut))


def test_a_throw_keeps_its_speed():
    """Nothing pushes a ball sideways in flight: a speed that stands still and explains the way is no dead one."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body pos="0 0 1"><freejoint name="ball"/><geom size=".1"/></body></worldbody></mujoco>'
    )
    data, rows = mujoco.MjData(model), 100
    data.qvel[:] = [1.3, 0, 4, 0, 0, 0]
    qpos, qvel = np.empty((rows, 7)), np.empty((rows, 6))
    for row in range(rows):
        qpos[row], qvel[row] = data.qpos, data.qvel
        mujoco.mj_step(model, data, 5)
    time = 0.01 * np.arange(rows)
    check_readings(model, Dataset([Episode("0", time, qpos, qvel, np.zeros((rows, 0)))]))
    dead = qvel.copy()
    dead[:, 0] = 0.4
    with pytest.raises(BadDataset, match=r"ball\.x: its qpos changes while its qvel stands still at 0\.4"):
        check_readings(model, Dataset([Episode("0", time, qpos, dead, np.zeros((rows, 0)))]))
