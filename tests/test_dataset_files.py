"""Files: round trips bit by bit through every format, and files written by other means."""

import json
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_array_equal

from nfpde.dataset import ColumnNames, Dataset, Episode, Metadata, load_dataset, save_dataset
from tests.full_disk import files_of_at_most

SUFFIXES = [".npz", ".csv", ".parquet"]
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
LABELS = st.text(st.characters(codec="utf-8", categories=["L", "N", "P", "S"]), min_size=1, max_size=8)
CSV = "episode,time,qpos_0,qvel_0,ctrl_0\n7,0,1,2,3\n7,0.1,1.5,2.5,3.5\n"


def same_bits(a, b):
    """Whether two data sets hold the same names and the same bits (so -0.0 differs from 0.0)."""
    return a.content_hash() == b.content_hash()


@st.composite
def datasets(draw):
    nv = draw(st.integers(1, 3))
    nq, nu = nv + draw(st.integers(0, 1)), draw(st.integers(0, 2))
    episodes = []
    for name in draw(st.lists(LABELS, min_size=1, max_size=3, unique=True)):
        rows = draw(st.integers(2, 5))
        columns = [draw(arrays(np.float64, (rows, n), elements=NUMBERS)) for n in (nq, nv, nu)]
        robot = draw(st.none() | LABELS)
        episodes.append(Episode(name, draw(st.floats(0, 10)) + 0.05 * np.arange(rows), *columns, robot=robot))
    metadata = Metadata(notes=draw(st.text(max_size=10)), versions=draw(st.dictionaries(LABELS, LABELS, max_size=2)))
    named = st.none() | st.lists(LABELS.filter(lambda s: not s.isdecimal()), min_size=nv, max_size=nv, unique=True)
    return Dataset(
        episodes, metadata=metadata, column_names=ColumnNames(qvel=draw(named.map(lambda n: n and tuple(n))))
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
@given(data=datasets())
@settings(max_examples=40, deadline=None)
def test_round_trip_is_bit_exact(suffix, data, tmp_path_factory):
    """Any data set comes back from each format with the same bits, names, robots and metadata."""
    path = tmp_path_factory.mktemp("round") / f"data{suffix}"
    save_dataset(data, path)
    back = load_dataset(path)
    assert same_bits(back, data)
    assert back.metadata == data.metadata
    assert back.column_names == data.column_names
    assert [e.robot for e in back] == [e.robot for e in data]
    assert back.source == str(path)
    assert {p.name for p in path.parent.iterdir()} <= {path.name, "data.meta.json"}


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_extreme_floats_survive(suffix, tmp_path):
    """The smallest and largest numbers, negative zero and 17-digit fractions keep their bits."""
    values = np.array([5e-324, -0.0, 1.7976931348623157e308, 0.1 + 0.2, 1 / 3, -2.2250738585072014e-308])
    data = Dataset([Episode("a", np.arange(6.0), values[:, None], values[::-1, None], np.zeros((6, 0)))])
    save_dataset(data, tmp_path / f"x{suffix}")
    back = load_dataset(tmp_path / f"x{suffix}")["a"]
    assert_array_equal(back.qpos.view(np.int64), data["a"].qpos.view(np.int64))
    assert_array_equal(back.qvel.view(np.int64), data["a"].qvel.view(np.int64))


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", ["007", "0", "99999999999999999999", "٣", "1e3", "3.0", "nan", "NA", "a,b", '"q"'])
def test_names_that_look_like_numbers(name, suffix, tmp_path):
    """Labels come back letter by letter, also where they could be taken for a number or a missing value."""
    save_dataset(
        Dataset([Episode(name, [0, 1], [[1], [2]], [[3], [4]], [[5], [6]], robot=name)]), tmp_path / f"d{suffix}"
    )
    back = load_dataset(tmp_path / f"d{suffix}")[0]
    assert (back.name, back.robot) == (name, name)


def test_npz_of_plain_numpy(tmp_path):
    """A file made with numpy alone loads: whole-number labels, integers, float32, an array that is not read."""
    np.savez(
        tmp_path / "d.npz",
        episode=[0, 0, 5, 5],
        time=np.array([0, 0.5, 0, 0.5], dtype=np.float32),
        qpos=[[1], [2], [3], [4]],
        qvel=np.zeros((4, 1)),
        ctrl=np.ones((4, 2)),
        temperature=np.zeros(9),
    )
    data = load_dataset(tmp_path / "d.npz")
    assert data.names == ["0", "5"]
    assert_array_equal(data["5"].qpos, [[3], [4]])
    assert data.control_dt == 0.5
    assert data.extra_columns == ("temperature",)


def test_saved_npz_is_what_the_format_says(tmp_path):
    """Numbered episodes are stored as numbers, one row each, with metadata as JSON text."""
    episode = Episode("3", [0, 1], [[1], [2]], [[3], [4]], [[5], [6]], robot="r")
    save_dataset(Dataset([episode]), tmp_path / "d.npz")
    with np.load(tmp_path / "d.npz", allow_pickle=False) as file:
        assert_array_equal(file["episode"], [3, 3])
        assert_array_equal(file["robot"], ["r", "r"])
        assert_array_equal(file["qpos"], [[1], [2]])
        assert json.loads(str(file["metadata"]))["notes"] == ""


def test_csv_by_hand(tmp_path):
    """Columns in any order, spaces around names, a column that is not read, Windows line ends, a byte order mark."""
    text = "ctrl_0, note,time,qvel_0,qpos_1,qpos_0,episode\r\n9,hi,0,1,2,3,run a\r\n8,,0.25,4,5,6,run a\r\n"
    (tmp_path / "d.csv").write_bytes(b"\xef\xbb\xbf" + text.replace("9,hi", " 9 ,hi").encode())
    data = load_dataset(tmp_path / "d.csv")
    assert data.names == ["run a"]
    assert_array_equal(data[0].qpos, [[3, 2], [6, 5]])
    assert_array_equal(data[0].ctrl, [[9], [8]])
    assert data.column_names == ColumnNames()
    assert data.extra_columns == ("note",)


def test_csv_with_element_names(tmp_path):
    """Named columns keep the file's order and their names."""
    text = "episode,time,qpos_elbow,qpos_base,qvel_elbow,qvel_base,ctrl_m\na,0,1,2,3,4,5\na,1,6,7,8,9,10\n"
    (tmp_path / "d.csv").write_text(text)
    data = load_dataset(tmp_path / "d.csv")
    assert data.column_names == ColumnNames(("elbow", "base"), ("elbow", "base"), ("m",))
    assert_array_equal(data[0].qpos, [[1, 2], [6, 7]])


def test_passive_csv_has_no_ctrl(tmp_path):
    """A table without ctrl columns is one of a passive system."""
    (tmp_path / "d.csv").write_text("episode,time,qpos_0,qvel_0\n0,0,1,2\n0,1,3,4\n")
    assert load_dataset(tmp_path / "d.csv").nu == 0


def test_csv_metadata_lies_beside_it(tmp_path):
    """NAME.meta.json is written, read back, and optional."""
    data = Dataset([Episode("0", [0, 1], [[1], [2]], [[3], [4]], [[5], [6]])], metadata=Metadata(solver="CG"))
    save_dataset(data, tmp_path / "d.csv")
    assert json.loads((tmp_path / "d.meta.json").read_text())["solver"] == "CG"
    (tmp_path / "d.meta.json").unlink()
    assert load_dataset(tmp_path / "d.csv").metadata == Metadata()


def test_parquet_of_other_writers(tmp_path):
    """Integers, float32, categories and missing robots load."""
    table = pa.table(
        {
            "episode": pa.array(["a", "a", "b", "b"]).dictionary_encode(),
            "robot": pa.array(["r", "r", None, None]),
            "time": pa.array([0, 1, 0, 1], pa.int32()),
            "qpos_0": pa.array([0.5, 1.5, 2.5, 3.5], pa.float32()),
            "qvel_0": pa.array([1, 2, 3, 4], pa.uint8()),
        }
    )
    pq.write_table(table, tmp_path / "d.parquet")
    data = load_dataset(tmp_path / "d.parquet")
    assert [(e.name, e.robot) for e in data] == [("a", "r"), ("b", None)]
    assert_array_equal(data["b"].qpos, [[2.5], [3.5]])


def test_formats_agree(tmp_path):
    """The content hash does not depend on the format."""
    data = Dataset([Episode("a b", [0, 0.1], [[0.1], [2]], [[3], [4]], [[5], [1 / 3]], robot="r,1")])
    for suffix in SUFFIXES:
        save_dataset(data, tmp_path / f"d{suffix}")
    assert len({load_dataset(tmp_path / f"d{suffix}").content_hash() for suffix in SUFFIXES}) == 1


def test_folder_of_files(tmp_path):
    """Every file of a folder is read in the order of names; episodes carry the file's name, notes are joined."""
    for name, note in (("b", "second"), ("a", "first")):
        (tmp_path / f"{name}.csv").write_text(CSV)
        (tmp_path / f"{name}.meta.json").write_text(json.dumps({"notes": note, "solver": "CG"}))
    (tmp_path / "README.md").write_text("not data")
    data = load_dataset(tmp_path)
    assert data.names == ["a/7", "b/7"]
    assert data.metadata == Metadata(notes="first\nsecond", solver="CG")


def test_failed_save_leaves_the_old_file(tmp_path, monkeypatch):
    """When writing fails half way the old file stands and no partial one is left."""
    data = Dataset([Episode("0", [0, 1], [[1], [2]], [[3], [4]], [[5], [6]])])
    save_dataset(data, tmp_path / "d.npz")
    before = (tmp_path / "d.npz").read_bytes()

    def half(file, **arrays):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez", half)
    with pytest.raises(OSError, match="disk full"):
        save_dataset(data, tmp_path / "d.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["d.npz"]
    assert (tmp_path / "d.npz").read_bytes() == before


def long_recording(value, rows):
    numbers = np.full((rows, 4), float(value))
    return Dataset([Episode("0", 0.01 * np.arange(rows), numbers, numbers, numbers)])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_leaves_the_old_file_and_is_named(suffix, tmp_path):
    """The system's reason and the file asked for; what was there loads as before, and nothing else is left."""
    path, old = tmp_path / f"d{suffix}", long_recording(1, 50)
    save_dataset(old, path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    with files_of_at_most(1000), pytest.raises(OSError, match="File too large") as raised:
        save_dataset(long_recording(2, 5000), path)
    assert raised.value.filename == str(path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_target_that_cannot_be_written_is_named(suffix, tmp_path):
    """The file asked for, not one beside it."""
    (tmp_path / f"d{suffix}").mkdir()
    with pytest.raises(OSError, match="directory") as raised:
        save_dataset(long_recording(1, 5), tmp_path / f"d{suffix}")
    assert raised.value.filename == str(tmp_path / f"d{suffix}")


def test_metadata_of_a_csv_come_first(tmp_path):
    """Where they cannot be written the rows are not either: without them they would load as if they had none."""
    (tmp_path / "d.meta.json").mkdir()
    with pytest.raises(OSError, match="directory"):
        save_dataset(long_recording(1, 5), tmp_path / "d.csv")
    assert not (tmp_path / "d.csv").exists()


WRITER = """
import sys
import numpy as np
from nfpde.dataset import Dataset, Episode, load_dataset, save_dataset

path, value = sys.argv[1], int(sys.argv[2])
mine = Dataset([Episode("0", 0.01 * np.arange(2000), *np.full((3, 2000, 4), float(value)))])
print("ready", flush=True)
sys.stdin.readline()
for _ in range(40):
    save_dataset(mine, path)
    found = load_dataset(path)[0].qpos
    assert (found == found[0, 0]).all()
"""


def test_two_processes_save_at_one_path(tmp_path):
    """Each load finds all of one data set: the other process's, or one's own."""
    path = tmp_path / "d.npz"
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path), str(i)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for i in range(2)
    ]  # fmt: skip
    for writer in writers:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "ready\n"
    for writer in writers:
        assert writer.stdin is not None
        writer.stdin.write("\n")
        writer.stdin.flush()
    for writer in writers:
        assert (writer.communicate(timeout=120)[1], writer.returncode) == ("", 0)
    assert list(tmp_path.iterdir()) == [path]
