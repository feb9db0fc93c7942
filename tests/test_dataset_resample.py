"""Resampling and cutting at gaps, against functions whose values are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from nfpde.dataset import Dataset, Episode, Metadata, load_dataset, resample_episode, split_episode_at_gaps
from nfpde.errors import BadDataset, BadInput


def along(time, name="a"):
    """A recording of straight lines: qpos 2t+1, qvel -t, ctrl the row number."""
    time = np.asarray(time, dtype=float)
    return Episode(name, time, 2 * time[:, None] + 1, -time[:, None], np.arange(len(time))[:, None])


def test_resample_by_hand():
    """Rows at 0, 0.5, 2 resampled to 1: midway values are interpolated; commands 0 and 1 share the first step."""
    new = resample_episode(along([0, 0.5, 2]), 1.0)
    assert_array_equal(new.time, [0, 1, 2])
    assert_allclose(new.qpos[:, 0], [1, 3, 5], rtol=1e-15)  # a straight line: only rounding
    assert_allclose(new.qvel[:, 0], [0, -1, -2], rtol=1e-15)
    assert_array_equal(new.ctrl[:, 0], [0.5, 1, 2])


@given(
    steps=st.lists(st.floats(0.5, 1.5), min_size=3, max_size=30),
    control_dt=st.floats(0.1, 1.0),
    start=st.floats(-5, 5),
)
@settings(max_examples=80, deadline=None)
def test_resampling_keeps_straight_lines_and_what_commands_do(steps, control_dt, start):
    """Linear signals stay linear at even times; commands, each until the next, keep their time integral.

    Where one acts from a row to the next, the row has exactly that one.
    """
    old = along(start + np.concatenate([[0], np.cumsum(steps)]))
    new = resample_episode(old, control_dt)
    assert_allclose(np.diff(new.time), control_dt, rtol=1e-9)  # times up to 50 s: rounding 1e-14 of steps of 0.1 s
    assert old.time[-1] - control_dt < new.time[-1] + 1e-9
    assert new.time[-1] <= old.time[-1] + 1e-9
    assert_allclose(new.qpos[:, 0], 2 * new.time + 1, rtol=0, atol=1e-8)  # values up to 110
    assert_allclose(new.qvel[:, 0], -new.time, rtol=0, atol=1e-8)
    sums = np.concatenate([[0], np.cumsum(old.ctrl[:-1, 0] * np.diff(old.time))])
    # what is within a millionth of a step of a new row counts as on it, at both ends: commands up to 30
    assert_allclose(
        new.ctrl[:-1, 0] * control_dt, np.diff(np.interp(new.time, old.time, sums)), rtol=0, atol=1e-4 * control_dt
    )
    shift = 1e-6 * control_dt
    first, last = (np.searchsorted(old.time, t, side="right") - 1 for t in (new.time + shift, new.time[1:] - shift))
    one = first[:-1] == last
    assert_array_equal(new.ctrl[:-1, 0][one], first[:-1][one])
    assert new.ctrl[-1, 0] == first[-1]
    assert Dataset([new]).control_dt == pytest.approx(control_dt, rel=1e-9)


def test_resampling_an_even_recording_to_its_own_step_changes_nothing():
    """Same number of rows, same commands, same values up to rounding, although 0.1 is no binary fraction."""
    for time in (
        np.cumsum(np.full(1001, 0.1)),
        1e6 + np.cumsum(np.full(1001, 0.1)),
        -np.cumsum(np.full(1001, 0.1))[::-1],
    ):
        turn = np.stack([np.cos(time), np.sin(time), 0 * time, 0 * time], axis=1)
        old = Episode("a", time, turn, turn[:, :3], np.arange(1001)[:, None])
        new = resample_episode(old, 0.1, quaternions=[0])
        assert len(new) == 1001
        assert_array_equal(new.ctrl, old.ctrl)
        assert_allclose(new.qpos, old.qpos, rtol=0, atol=1e-8)  # a clock at 1e6 s rounds to 1e-10 s
        assert_allclose(new.qvel, old.qvel, rtol=0, atol=1e-8)


@pytest.mark.parametrize("jitter", [0.02, 0.2, 0.45])
def test_a_jittering_clock_makes_no_command_late(jitter):
    """A velocity that is the integral of the command changes from row to row by exactly what the rows command."""
    rng = np.random.default_rng(3)
    n, dt = 500, 0.01
    time = dt * (np.arange(n) + rng.uniform(-jitter, jitter, n))
    ctrl = np.repeat(rng.normal(size=(n // 4, 2)), 4, axis=0)
    speed = np.concatenate([np.zeros((1, 2)), np.cumsum(ctrl[:-1] * np.diff(time)[:, None], axis=0)])
    new = resample_episode(Episode("a", time, 0 * speed, speed, ctrl), dt)
    assert_allclose(np.diff(new.qvel, axis=0), dt * new.ctrl[:-1], rtol=0, atol=1e-14)  # sums of 500 in float64


def test_one_command_all_the_way_is_the_recorded_one_bit_for_bit():
    """A command that is sent again in between, or whose row is a rounding error off, is not averaged."""
    time = 1e-2 * np.arange(40) + np.where(np.arange(40) % 3, 0.2e-8, -0.2e-8)
    value = np.where(np.arange(40) % 2, 0.1, -0.0)[:, None]
    old = Episode("a", time - time[0], value, value, np.hstack([value, np.full((40, 1), 0.7)]))
    for new in (resample_episode(old, 0.01), resample_episode(old, 0.005)):
        row = np.minimum(np.round(new.time / 0.01 - 0.1).astype(int), 39)
        assert new.ctrl.tobytes() == old.ctrl[row].tobytes()
    assert_array_equal(resample_episode(old, 0.013).ctrl[:, 1], 0.7)


def test_quaternions_turn_at_constant_rate():
    """A turn about z at constant rate stays exactly that turn, of unit length, with the recorded sign."""
    uneven = np.array([0.0, 0.3, 0.5, 1.0])

    def turned(time):
        q = np.zeros((len(time), 4))
        q[:, 0], q[:, 3] = np.cos(time), np.sin(time)  # angle 2t about z
        return -q  # the other sign of the same rotation

    old = Episode("a", uneven, np.hstack([uneven[:, None], turned(uneven)]), np.zeros((4, 4)), np.zeros((4, 0)))
    new = resample_episode(old, 0.1, quaternions=[1])
    assert_allclose(new.qpos[:, 1:], turned(new.time), atol=1e-14)  # slerp is exact for one axis: rounding only
    assert_allclose(new.qpos[:, 0], new.time, atol=1e-14)


def test_quaternion_slerp_agrees_with_rotation_vectors():
    """Between two random attitudes the new ones lie on the geodesic: the same turn in each part of the way."""
    first, last = Rotation.random(2, rng=np.random.default_rng(5))
    ends = np.array([first.as_quat(scalar_first=True), last.as_quat(scalar_first=True)])
    old = Episode("a", [0.0, 1.0], ends, np.zeros((2, 3)), np.zeros((2, 0)))
    new = resample_episode(old, 0.25, quaternions=[0])
    turn = (first.inv() * last).as_rotvec()
    for t, q in zip(new.time, new.qpos, strict=True):
        expected = first * Rotation.from_rotvec(t * turn)
        got = Rotation.from_quat(q, scalar_first=True)
        assert (expected.inv() * got).magnitude() < 1e-7  # arccos near 1 loses half the digits


def test_sign_flips_in_the_recording_do_not_matter():
    """A quaternion and its negative are one rotation: one that jumps between them resamples the same."""
    angle = np.linspace(0, 1, 11)
    q = np.stack([np.cos(angle), np.sin(angle), 0 * angle, 0 * angle], axis=1)
    flips = np.where(np.arange(11) % 3 == 0, -1.0, 1.0)[:, None]
    smooth = Episode("a", angle, q, np.zeros((11, 3)), np.zeros((11, 0)))
    jumpy = Episode("a", angle, q * flips, np.zeros((11, 3)), np.zeros((11, 0)))
    a, b = (resample_episode(e, 0.03, quaternions=[0]).qpos for e in (smooth, jumpy))
    assert_allclose(np.abs(np.sum(a * b, axis=1)), 1, atol=1e-12)


def test_quaternions_must_be_named():
    """A column more in qpos than in qvel is a quaternion that must be named, not averaged."""
    e = Episode("a", [0, 1], [[1, 0, 0, 0]] * 2, np.zeros((2, 3)), np.zeros((2, 0)))
    with pytest.raises(BadInput, match="nq=4 and nv=3, so 1 unit quaternion"):
        resample_episode(e, 0.5)
    with pytest.raises(BadInput, match="inside nq=4"):
        resample_episode(e, 0.5, quaternions=[1])


def test_long_gaps_are_refused_and_short_ones_bridged():
    """Six median steps are too long by default; `max_gap` moves the limit."""
    e = along([0, 1, 2, 3, 9, 10, 11])
    with pytest.raises(BadDataset, match=r"row 4: 6 s passed .* longer than max_gap=5 s \(1 such gap"):
        resample_episode(e, 1)
    assert len(resample_episode(e, 1, max_gap=6.5)) == 12


def test_split_at_gaps():
    """Pieces keep their rows and numbers, are numbered, and a lone row between two gaps is left out."""
    pieces = split_episode_at_gaps(along([0, 1, 2, 10, 20, 21, 22, 23]))
    assert [p.name for p in pieces] == ["a/0", "a/1"]
    assert_array_equal(pieces[0].time, [0, 1, 2])
    assert_array_equal(pieces[1].ctrl[:, 0], [4, 5, 6, 7])
    whole = along([0, 1, 2])
    assert split_episode_at_gaps(whole) == [whole]


def test_loading_resampled_and_split(tmp_path):
    """An uneven file is refused as it is, loads with `resample`, and loads in pieces with `split_gaps`."""
    time = np.array([0, 1.1, 2, 4, 14, 15, 16, 17.1])  # steps of 1, one of 2 to bridge, one of 10 to cut at
    arrays = {"episode": np.zeros(8, int), "qpos": time[:, None], "qvel": time[:, None], "ctrl": time[:, None]}
    np.savez(tmp_path / "d.npz", time=time, **arrays)
    with pytest.raises(BadDataset, match="split_gaps=True"):
        load_dataset(tmp_path / "d.npz")
    data = load_dataset(tmp_path / "d.npz", resample=0.5, split_gaps=True)
    assert data.names == ["0/0", "0/1"]
    assert data["0/0"].duration == 4
    assert data.control_dt == 0.5
    assert data.metadata.control_dt == 0.5
    assert_allclose(data["0/1"].qpos[:, 0], 14 + 0.5 * np.arange(7), rtol=1e-12)
    assert len(load_dataset(tmp_path / "d.npz", resample=0.5, max_gap=10.5)["0"]) == 35


def test_pieces_too_short_for_one_step_are_left_out(tmp_path):
    """Cutting at gaps may leave a piece of less than one new control step; the others load, numbered as cut."""
    time = np.array([0, 0.1, 0.2, 0.3, 5, 5.1, 9, 9.1, 9.2, 9.3])
    arrays = {"episode": np.zeros(10, int), "qpos": time[:, None], "qvel": time[:, None], "ctrl": time[:, None]}
    np.savez(tmp_path / "d.npz", time=time, **arrays)
    data = load_dataset(tmp_path / "d.npz", resample=0.15, split_gaps=True)
    assert data.names == ["0/0", "0/2"]
    assert_allclose(data["0/2"].time, [9, 9.15, 9.3])


def test_gaps_that_leave_no_piece_long_enough_are_named(tmp_path):
    """Both pieces last 0.1 s: one step of 0.1 s fits, but for rounding, and none of 0.2 s."""
    time = np.array([0, 0.1, 5, 5.1])
    arrays = {"episode": np.zeros(4, int), "qpos": time[:, None], "qvel": time[:, None], "ctrl": time[:, None]}
    np.savez(tmp_path / "d.npz", time=time, **arrays)
    assert load_dataset(tmp_path / "d.npz", resample=0.1, split_gaps=True).names == ["0/0", "0/1"]
    text = (
        r"episode '0': cut at its gaps \(steps longer than max_gap=0\.5 s\), its longest piece lasts 0\.1 s, less than"
    )
    with pytest.raises(BadDataset, match=text + r" one control step of 0\.2 s; resample to a smaller step"):
        load_dataset(tmp_path / "d.npz", resample=0.2, split_gaps=True)
    with pytest.raises(BadInput, match="resample is nan; it must be a positive number of seconds"):
        load_dataset(tmp_path / "d.npz", resample=float("nan"), split_gaps=True)


def test_the_whole_episode_decides_what_a_gap_is(tmp_path):
    """A piece of denser rows than the rest may keep steps that its own median would call gaps."""
    time = np.concatenate([np.arange(8.0), 20 + np.array([0, 0.5, 1, 4, 4.5, 5])])
    arrays = {"episode": np.zeros(14, int), "qpos": time[:, None], "qvel": time[:, None], "ctrl": time[:, None]}
    np.savez(tmp_path / "d.npz", time=time, **arrays)
    data = load_dataset(tmp_path / "d.npz", resample=0.5, split_gaps=True)
    assert data.names == ["0/0", "0/1"]
    assert_allclose(data["0/1"].qpos[:, 0], 20 + 0.5 * np.arange(11))


def test_arguments_that_would_do_nothing_are_refused(tmp_path):
    """`quaternions` and `max_gap` only mean something together with what uses them."""
    with pytest.raises(
        BadInput, match="quaternions is given without resample or differentiate, where it would do nothing"
    ):
        load_dataset(tmp_path / "d.npz", quaternions=[3])
    with pytest.raises(BadInput, match="max_gap is given without resample or split_gaps, where it would do nothing"):
        load_dataset(tmp_path / "d.npz", max_gap=1.0)


def test_dataset_resample_updates_the_metadata():
    """An evenly spaced data set resamples as a whole and its stated control step follows."""
    data = Dataset([along(np.arange(5.0)), along(np.arange(4.0), "b")], metadata=Metadata(control_dt=1.0))
    new = data.resample(0.25)
    assert new.control_dt == new.metadata.control_dt == 0.25
    assert [len(e) for e in new] == [17, 13]
    assert_array_equal(new["b"].ctrl[:5, 0], [0, 0, 0, 0, 1])
