"""Episodes, data sets, windows and splits: small cases by hand, and windows against a naive loop."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from nfpde.dataset import ColumnNames, Dataset, Episode, Metadata, Windows
from nfpde.errors import BadInput


def counted(name="a", rows=4, robot=None, dt=0.1, start=0.0):
    """An episode whose numbers say where they stand: qpos r, r+0.5; qvel 100+r, ...; ctrl 1000+r."""
    r = start + np.arange(rows)
    return Episode(
        name=name,
        time=dt * np.arange(rows),
        qpos=np.column_stack([r, r + 0.5]),
        qvel=np.column_stack([100 + r, 100.5 + r]),
        ctrl=1000 + r[:, None],
        robot=robot,
    )


def test_episode_arrays_are_float64_read_only_copies():
    """An episode holds its own read-only float64 arrays: a later change outside, or inside, cannot reach it."""
    qpos = np.array([[1, 2], [3, 4]], dtype=np.int32)
    episode = Episode("a", np.array([0.0, 1.0]), qpos, qpos.astype(np.float32)[:, ::-1], np.zeros((2, 0)))
    qpos[0, 0] = 99
    assert_array_equal(episode.qpos, [[1.0, 2.0], [3.0, 4.0]])
    for array in (episode.time, episode.qpos, episode.qvel, episode.ctrl):
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_episode_knows_its_sizes():
    """Rows, columns and duration are those of the arrays."""
    episode = counted(rows=5)
    assert (len(episode), episode.nq, episode.nv, episode.nu) == (5, 2, 2, 1)
    assert episode.duration == pytest.approx(0.4, rel=1e-15)  # 4 steps of 0.1 s, rounded once or twice


def test_dataset_is_a_sequence_of_episodes():
    """Length, iteration, indexing by position and by name, sizes and robots."""
    a, b = counted("a", robot="r2"), counted("b", rows=6, robot="r1")
    data = Dataset([a, b])
    assert len(data) == 2
    assert list(data) == [a, b] == [data[0], data["b"]]
    assert (data.nq, data.nv, data.nu, data.nrow) == (2, 2, 1, 10)
    assert data.names == ["a", "b"]
    assert data.robots == ["r2", "r1"]
    with pytest.raises(BadInput, match="no episode is named 'c'; there are a, b"):
        data["c"]


def test_control_dt_is_free_of_rounding():
    """Times summed up step by step, with the rounding errors of a thousand sums, still give exactly 0.1."""
    summed = replace(counted(rows=1000), time=np.cumsum(np.full(1000, 0.1)))
    assert summed.duration / 999 != 0.1
    assert Dataset([summed, counted("b", rows=77)]).control_dt == 0.1


def test_control_dt_is_the_mean_over_all_steps():
    """Two episodes of slightly different clocks: total time over total steps."""
    data = Dataset([counted("a", rows=11, dt=0.1), counted("b", rows=31, dt=0.10004)])
    assert data.control_dt == pytest.approx((10 * 0.1 + 30 * 0.10004) / 40, rel=1e-11)  # kept to 12 digits


def test_windows_by_hand():
    """Rows 0 to 6 in windows of 2 steps: starts 0, 2, 4; commands and states line up; no overlap by default."""
    windows = Dataset([counted(rows=7)]).windows(2, history=1)
    assert len(windows) == 3
    assert (windows.horizon, windows.nhistory, windows.nq, windows.nv, windows.nu) == (2, 1, 2, 2, 1)
    assert_array_equal(windows.row, [0, 2, 4])
    assert_array_equal(windows.start, [[0, 0.5, 100, 100.5], [2, 2.5, 102, 102.5], [4, 4.5, 104, 104.5]])
    assert_array_equal(windows.target[:, :, 0], [[1, 2], [3, 4], [5, 6]])
    assert_array_equal(windows.ctrl[:, :, 0], [[1000, 1001], [1002, 1003], [1004, 1005]])
    assert_array_equal(windows.history[:, :, 0], [[1000], [1001], [1003]])


def test_transitions_are_all_single_steps_and_history_repeats_the_first_command():
    """T rows give T-1 transitions; before the first row the first command of the same episode stands."""
    data = Dataset([counted("a", rows=2), counted("b", rows=4, start=50)])
    windows = data.transitions(history=3)
    assert_array_equal(windows.episode, [0, 1, 1, 1])
    assert_array_equal(windows.row, [0, 0, 1, 2])
    expected = [[1000, 1000, 1000], [1050, 1050, 1050], [1050, 1050, 1050], [1050, 1050, 1051]]
    assert_array_equal(windows.history[:, :, 0], expected)
    assert_array_equal(windows.target[:, 0, 0], [1, 51, 52, 53])


def test_short_episodes_are_skipped_and_listed():
    """An episode of 3 rows holds no window of 3 steps; the others do."""
    windows = Dataset([counted("a", rows=3), counted("b", rows=4), counted("c", rows=2)]).windows(3)
    assert windows.skipped_episodes == (0, 2)
    assert_array_equal(windows.episode, [1])


def naive_windows(data, horizon, stride, history):
    """The definition, row by row."""
    found = []
    for index, e in enumerate(data):
        for row in range(0, len(e) - horizon, stride):
            state = [np.concatenate([e.qpos[r], e.qvel[r]]) for r in range(row, row + horizon + 1)]
            before = [e.ctrl[max(r, 0)] for r in range(row - history, row)]
            found.append((index, row, np.array(state), e.ctrl[row : row + horizon], before))
    return found


@given(
    rows=st.lists(st.integers(2, 12), min_size=1, max_size=5),
    horizon=st.integers(1, 6),
    stride=st.integers(1, 5),
    history=st.integers(0, 4),
    past=st.integers(0, 4),
)
@settings(max_examples=60, deadline=None)
def test_windows_agree_with_a_naive_loop(rows, horizon, stride, history, past):
    """For any lengths, horizon, stride, history and past the vectorised windows are those of the plain definition."""
    data = Dataset([counted(str(i), n, start=100.0 * i) for i, n in enumerate([*rows, horizon + 1])])
    windows = data.windows(horizon, stride=stride, history=history, past=past)
    expected = naive_windows(data, horizon, stride, history)
    assert len(windows) == len(expected)
    for i, (index, row, state, ctrl, before) in enumerate(expected):
        assert (windows.episode[i], windows.row[i]) == (index, row)
        assert_array_equal(windows.state[i], state)
        assert_array_equal(windows.ctrl[i], ctrl)
        assert_array_equal(windows.history[i], np.reshape(before, (history, 1)))
        unknown = max(0, past - row)
        assert np.isnan(windows.past[i, :unknown]).all()
        episode = data.episodes[index]
        known = np.hstack([episode.qpos, episode.qvel])[max(row - past, 0) : row]
        assert_array_equal(windows.past[i, unknown:], known)


def test_windows_indexing_keeps_rows_together():
    """Slice, index array, mask and single index pick the same rows of every array, and are read-only."""
    windows = Dataset([counted(rows=6)]).windows(1, history=1, past=1)
    mask = np.array([False, True, False, True, False])
    for index in (slice(1, 4, 2), np.array([1, 3]), [1, 3], mask):
        picked = windows[index]
        assert isinstance(picked, Windows)
        assert_array_equal(picked.row, [1, 3])
        assert_array_equal(picked.start[:, 0], [1, 3])
        assert_array_equal(picked.ctrl[:, 0, 0], [1001, 1003])
        assert_array_equal(picked.history[:, 0, 0], [1000, 1002])
        assert_array_equal(picked.past[:, 0, 0], [0, 2])
        assert not picked.state.flags.writeable
    assert len(windows[-1]) == 1
    assert windows[-1].row[0] == 4
    assert [w.row[0] for w in windows] == [0, 1, 2, 3, 4]


def test_batches_cover_every_window_once():
    """Minibatch indices are a partition; the seed decides the order; without one the order is kept."""
    windows = Dataset([counted(rows=24)]).transitions()
    batches = list(windows.batches(5, seed=3))
    assert [len(b) for b in batches] == [5, 5, 5, 5, 3]
    assert_array_equal(np.sort(np.concatenate(batches)), np.arange(23))
    assert_array_equal(np.concatenate(batches), np.concatenate(list(windows.batches(5, seed=3))))
    assert (np.concatenate(batches) != np.concatenate(list(windows.batches(5, seed=4)))).any()
    assert_array_equal(np.concatenate(list(windows.batches(5))), np.arange(23))


@pytest.mark.parametrize(("share", "expected"), [(0.01, 1), (0.3, 3), (0.5, 5), (0.99, 9)])
def test_split_by_share_of_episodes(share, expected):
    """The share is rounded, yet neither side is ever empty; together both sides are the data set, in order."""
    data = Dataset([counted(str(i)) for i in range(10)])
    rest, out = data.split(share, seed=1)
    assert len(out) == expected
    assert sorted(rest.names + out.names, key=int) == data.names
    assert rest.names == sorted(rest.names, key=int)
    assert out.names == data.split(share, seed=1)[1].names


@pytest.mark.parametrize("share", [np.float32(0.5), np.float64(0.5), np.float16(0.5)])
def test_split_by_a_numpy_share(share):
    """Of any precision, as a plain one."""
    data = Dataset([counted(str(i)) for i in range(4)])
    assert data.split(share)[1].names == data.split(0.5)[1].names


def test_split_seeds_differ():
    """Among many seeds each episode is held out at some time."""
    data = Dataset([counted(str(i)) for i in range(4)])
    assert {data.split(0.25, seed=s)[1].names[0] for s in range(60)} == {"0", "1", "2", "3"}


@pytest.mark.parametrize("seed", range(5))
def test_split_never_divides_a_robot(seed):
    """With several robots labelled a share is one of robots, and no robot is on both sides."""
    data = Dataset([counted(str(i), robot=f"r{i % 3}") for i in range(12)])
    rest, out = data.split(0.34, seed=seed)
    assert len(out.robots) == 1
    assert len(out) == 4
    assert not set(rest.robots) & set(out.robots)


def test_split_of_one_labelled_robot_is_by_episode():
    """A single robot cannot be held out from itself, so its episodes are divided."""
    rest, out = Dataset([counted(str(i), robot="only") for i in range(4)]).split(0.5)
    assert (len(rest), len(out)) == (2, 2)


def test_split_by_names():
    """Names of episodes and robots both select."""
    data = Dataset([counted("a", robot="r1"), counted("b", robot="r2"), counted("c", robot="r2"), counted("d")])
    assert data.split(["r2", "a"])[1].names == ["a", "b", "c"]
    assert data.split(["r2", "a"])[0].names == ["d"]


def test_split_keeps_everything_else():
    """Metadata, column names and source follow to both sides."""
    names = ColumnNames(qpos=("x", "y"))
    data = Dataset([counted("a"), counted("b")], metadata=Metadata(notes="n"), column_names=names, source="f.npz")
    for part in data.split(["a"]):
        assert (part.metadata, part.column_names, part.source) == (data.metadata, names, "f.npz")


def test_content_hash_sees_content_only():
    """Equal content has equal hash whatever the metadata; any changed number, name or robot changes it."""
    data = Dataset([counted("a"), counted("b")])
    same = Dataset([counted("a"), counted("b")], metadata=Metadata(notes="other"), source="elsewhere")
    assert data.content_hash() == same.content_hash()
    others = [
        Dataset([counted("b"), counted("a")]),
        Dataset([counted("a"), counted("c")]),
        Dataset([counted("a"), counted("b", robot="r")]),
        Dataset([counted("a"), counted("b", start=1e-12)]),
        Dataset([counted("a"), counted("b")], column_names=ColumnNames(ctrl=("m",))),
        Dataset([counted("a")]),
    ]
    hashes = {d.content_hash() for d in [data, *others]}
    assert len(hashes) == 7
    assert all(len(h) == 64 for h in hashes)


def test_metadata_round_trips_through_json():
    """Every field survives, and the mappings are copies."""
    versions = {"mujoco": "4.0"}
    full = Metadata("h", 0.02, 0.002, "Newton", "RK4", versions, {"inertia": "scaled"}, "näme\nline")
    versions["mujoco"] = "changed"
    assert full.versions == {"mujoco": "4.0"}
    assert Metadata.from_json(full.to_json()) == full
    assert Metadata.from_json("{}") == Metadata()


def test_some_windows_are_those_of_all():
    """`at` picks among all that fit, with what comes before them."""
    data = Dataset([counted(name, rows, start=100.0 * rows) for name, rows in (("a", 9), ("b", 3), ("c", 14))])
    every = data.windows(3, stride=2, history=4, past=5)
    at = np.array([7, 0, 3])
    some = data.windows(3, stride=2, history=4, past=5, at=at)
    for name in ("state", "ctrl", "history", "past", "episode", "row"):
        assert_array_equal(getattr(some, name), getattr(every, name)[at])
    assert some.skipped_episodes == every.skipped_episodes
