"""Refused files, read by the text of the refusal: what is wrong, where, the rule and what to do."""

import json
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from nfpde.dataset import Dataset, Episode, Metadata, load_dataset, save_dataset
from nfpde.errors import BadDataset


def good(**changes):
    """The arrays of a good file of two episodes of three rows, with some changed (None removes one)."""
    arrays = {
        "episode": np.array([0, 0, 0, 1, 1, 1]),
        "time": np.array([0, 0.1, 0.2, 0, 0.1, 0.2]),
        "qpos": np.zeros((6, 3)),
        "qvel": np.zeros((6, 3)),
        "ctrl": np.zeros((6, 2)),
    } | changes
    return {name: array for name, array in arrays.items() if array is not None}


def with_value(field, row, value, column=None):
    """The good arrays with one value changed."""
    array = good()[field].astype(float)
    array[row if column is None else (row, column)] = value
    return good(**{field: array})


def robots(*labels):
    return good(robot=np.array(labels))


NPZ = {
    "missing arrays": (
        good(qvel=None, ctrl=None),
        "missing array(s) qvel, ctrl; arrays found: episode (6,), time (6,)",
    ),
    "passive remedy": (good(ctrl=None), "for a passive system save ctrl with shape (R, 0)"),
    "qpos of one dimension": (good(qpos=np.zeros(6)), "qpos has shape (6,); it must have two dimensions"),
    "time of two dimensions": (good(time=np.zeros((6, 1))), "time has shape (6, 1); it must have one dimension"),
    "episode of two dimensions": (good(episode=np.zeros((6, 1), int)), "episode has shape (6, 1); it must have one"),
    "length": (good(qvel=np.zeros((5, 3))), "qvel has 5 rows and episode has 6; every array needs the same number"),
    "robot length": (good(robot=np.array(["r"])), "robot has 1 rows and episode has 6"),
    "nan": (with_value("qpos", 4, np.nan, 2), "episode '1', row 1, column qpos_2: the value is nan; every value must"),
    "place in file": (with_value("qpos", 4, np.nan, 2), "(Episode '1' begins at row 3 of the file, counted from 0.)"),
    "inf in last ctrl": (
        with_value("ctrl", 5, np.inf, 1),
        "row 2, column ctrl_1: the value is inf; every value must be",
    ),
    "last ctrl remedy": (with_value("ctrl", 5, np.inf, 1), "the last row's command is not used; put 0 there"),
    "nan time": (with_value("time", 1, np.nan), "episode '0', row 1, column time: the value is nan"),
    "time backwards": (with_value("time", 2, 0.05), "episode '0', row 2, column time: 0.05 s follows 0.1 s; time must"),
    "time repeated": (with_value("time", 5, 0.1), "Remove the repeated row, or begin a new episode there"),
    "text": (good(qpos=np.full((6, 3), "1.0")), "qpos holds text; it must hold real numbers. Convert it to float64"),
    "complex": (good(qvel=np.zeros((6, 3), complex)), "qvel holds complex numbers; it must hold real numbers"),
    "dates": (good(time=np.arange(6).astype("datetime64[s]")), "time holds dates; it must hold real numbers"),
    "objects": (good(qpos=np.full((6, 3), None)), "array qpos cannot be read"),
    "objects, remedy": (good(qpos=np.full((6, 3), None)), "would have to be unpickled, which could run code"),
    "huge integers": (
        good(time=np.arange(6) + 2**53),
        "time holds the integer 9007199254740997 (sign dropped), beyond",
    ),
    "huge integers, remedy": (good(time=np.arange(6) - 2**60), "subtract the first stamp as an integer, then divide"),
    "one-row episode": (
        good(episode=np.array([0, 0, 0, 1, 1, 2]), time=np.array([0, 1, 2, 0, 1, 0])),
        "episode '2' has 1 row(s); at least 2",
    ),
    "scattered episode": (good(episode=np.array([0, 0, 1, 1, 0, 0])), "episode '0' begins at row 0 and again at row 4"),
    "two robots": (
        robots("a", "a", "a", "b", "b", "c"),
        "episode '1', row 2, column robot: 'c' where the episode began with 'b'",
    ),
    "fractional label": (
        good(episode=np.array([0, 0, 0, 1.5, 1.5, 1.5])),
        "row 3, column episode: 1.5 is no whole number",
    ),
    "nan label": (good(episode=np.array([0, 0, 0, np.nan, 1, 1])), "row 3, column episode: nan is no whole number"),
    "blank label": (good(episode=np.array([""] * 6)), "an episode's name is ''; it must be printable text, not empty"),
    "label with spaces": (good(episode=np.array([" a"] * 3 + ["b"] * 3)), "name is ' a'; it must be printable text"),
    "no rows": ({n: a[:0] for n, a in good().items()}, "there are no rows; a data set holds at least one episode"),
    "no qpos": (
        good(qpos=np.zeros((6, 0)), qvel=np.zeros((6, 0))),
        "has no position column (nq=0); at least 1 is needed",
    ),
    "swapped": (good(qpos=np.zeros((6, 2))), "nq=2 position columns and nv=3 velocity columns; a MuJoCo model never"),
    "unknown array": (
        good(qpos_filtered=np.zeros(6)),
        "unknown column(s) or array(s) qpos_filtered: a name that begins",
    ),
    "metadata no JSON": (good(metadata=np.array("{")), "the metadata is no JSON"),
    "metadata no text": (
        good(metadata=np.zeros(3)),
        "the array metadata has type float64 and shape (3,); it must be one",
    ),
    "metadata list": (good(metadata=np.array("[1]")), "the metadata is a JSON list; it must be a JSON object"),
    "metadata field": (
        good(metadata=np.array('{"dt": 1}')),
        "the metadata has unknown field(s) dt; known are model_hash",
    ),
    "metadata value": (
        good(metadata=np.array('{"timestep": "2"}')),
        "the metadata's timestep is '2'; it must be a positive",
    ),
    "metadata step": (
        good(metadata=np.array('{"control_dt": 0.02}')),
        "says control_dt=0.02 s and the time column steps by 0.1 s",
    ),
    "name count": (good(ctrl_names=np.array(["m"])), "ctrl has 2 column(s) and 1 name(s): m"),
    "names twice": (good(ctrl_names=np.array(["m", "m"])), "the ctrl names hold m more than once; names are unique"),
    "digit name": (
        good(ctrl_names=np.array(["m", "7"])),
        "a ctrl column is named '7'; a name of digits alone reads as",
    ),
    "gap": (with_value("time", [3, 4, 5], [0, 0.1, 0.6]), "episode '1', row 2: 0.5 s passed since the row before"),
}


@pytest.mark.parametrize("case", NPZ)
def test_npz_refusals(case, tmp_path):
    """Each broken file is refused with the file's name first and a text that says where and what."""
    arrays, text = NPZ[case]
    path = tmp_path / "log.npz"
    np.savez(path, **arrays)
    with pytest.raises(BadDataset, match=re.escape(text)) as refusal:
        load_dataset(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert str(refusal.value).count(str(path)) == 1


HEAD = "episode,time,qpos_0,qvel_0,ctrl_0\n"
CSV = {
    "missing columns": (
        "episode,when,qpos_0,ctrl_0\n0,0,1,2\n",
        "missing column(s) time, qvel_0 (or qvel_ELEMENT); columns found: episode, when, qpos_0",
    ),
    "semicolons": ("episode;time;qpos_0;qvel_0\n0;0;1;2\n", "separated by commas"),
    "repeated column": (
        "episode,time,qpos_0,qpos_0,qvel_0\n0,0,1,2,3\n",
        "column(s) qpos_0 stand more than once in the header",
    ),
    "number gap": (
        "episode,time,qpos_0,qpos_2,qvel_0\n0,0,1,2,3\n",
        "the qpos columns are qpos_0, qpos_2, so qpos_1 is missing",
    ),
    "leading zero": (
        "episode,time,qpos_00,qvel_0\n0,0,1,2\n",
        "qpos_0 is missing; 1 columns are numbered from qpos_0 to qpos_0, without gaps",
    ),
    "mixed": (
        "episode,time,qpos_0,qpos_elbow,qvel_0\n0,0,1,2,3\n",
        "the qpos columns mix numbers and names (qpos_0, qpos_elbow)",
    ),
    "bare qpos": (
        "episode,time,qpos,qvel_0\n0,0,1,2\n",
        "unknown column(s) or array(s) qpos: a name that begins with qpos",
    ),
    "near name": (HEAD.replace("ctrl_0", "ctrl0") + "0,0,1,2,3\n", "unknown column(s) or array(s) ctrl0"),
    "no number": (
        HEAD + "0,0,1,2,3\n0,1,1,2 rad,3\n",
        "row 1, column qvel_0: '2 rad' is no number (rows are counted from 0",
    ),
    "empty cell": (
        HEAD + "0,0,1,2,3\n0,1,,2,3\n",
        "row 1, column qpos_0: the cell is empty (1 empty cell(s) in the column)",
    ),
    "nan cell": (HEAD + "0,0,1,2,3\n0,1,nan,2,3\n", "episode '0', row 1, column qpos_0: the value is nan"),
    "short row": (
        HEAD + "0,0,1,2,3\n0,1,1\n",
        "row 1 has 3 cells and the header 5 (rows are counted from 0 below the header)",
    ),
    "long row below an empty line": (
        HEAD + "0,0,1,2,3\n\n0,1,1,2,3\n0,2,1,2,3,4\n",
        "row 2 has 6 cells and the header 5 (rows are counted from 0 below the header); every row has one cell a",
    ),
    "decimal comma": (HEAD + "0,0,1,2,3\n0,1,1,2,3,5\n", "a decimal comma or a comma in a text reads as two cells"),
    "marks between digits": (
        HEAD + "0,0,1,2,3\n0,1,1_000,2,3\n",
        "row 1, column qpos_0: '1_000' is no number (rows are counted from 0 below the header)",
    ),
    "digits of other scripts": (HEAD + "0,0,1,2,٣\n0,1,1,2,3\n", "row 0, column ctrl_0: '٣' is no number"),
    "no header": ("", "the file has no header line; the first line must name the columns"),
    "no rows": (HEAD, "there are no rows; a data set holds at least one episode"),
}


@pytest.mark.parametrize("case", CSV)
def test_csv_refusals(case, tmp_path):
    """Each broken table is refused with its place and rule."""
    content, text = CSV[case]
    (tmp_path / "log.csv").write_text(content)
    with pytest.raises(BadDataset, match=re.escape(text)) as refusal:
        load_dataset(tmp_path / "log.csv")
    assert str(refusal.value).startswith(f"{tmp_path / 'log.csv'}: ")


def test_csv_in_another_encoding(tmp_path):
    """A file that is no UTF-8 is refused in the header and in the cells."""
    (tmp_path / "a.csv").write_bytes(HEAD.encode("utf-16"))
    with pytest.raises(BadDataset, match="cannot be read as UTF-8 text"):
        load_dataset(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_bytes(HEAD.encode() + b"0,0,1,2,3\n" * 9999 + b"\xff,1,1,2,3\n")
    with pytest.raises(BadDataset, match=r"cannot be read as a table .*UTF8"):
        load_dataset(tmp_path / "b.csv")


def test_bad_sidecar_names_itself(tmp_path):
    """A broken NAME.meta.json is refused under its own name."""
    (tmp_path / "log.csv").write_text(HEAD + "0,0,1,2,3\n0,1,1,2,3\n")
    (tmp_path / "log.meta.json").write_text(json.dumps({"versions": {"mujoco": 4}}))
    with pytest.raises(BadDataset, match=r"log\.meta\.json: the metadata's versions is .* mapping from text to text"):
        load_dataset(tmp_path / "log.csv")


def parquet(path, **changes):
    columns = {"episode": ["a", "a"], "time": [0.0, 1.0], "qpos_0": [1.0, 2.0], "qvel_0": [0.0, 0.0]}
    pq.write_table(pa.table(columns | changes), path)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"qpos_0": ["1", "2"]}, "column qpos_0 holds string; it must hold numbers"),
        ({"time": pa.array([1, 2], pa.timestamp("ns"))}, "column time holds timestamp"),
        ({"time": pa.array([2**60, 2**60 + 1])}, "column time holds the integer"),
        ({"qvel_0": [1.0, None]}, "row 1, column qvel_0: the cell is empty"),
        ({"qvel_0": pa.array([None, None])}, r"row 0, column qvel_0: the cell is empty \(2 empty"),
        ({"episode": ["a", None]}, "row 1, column episode: the cell is empty"),
        ({"qpos_0": [[1.0], [2.0]]}, "column qpos_0 holds list"),
    ],
)
def test_parquet_refusals(changes, text, tmp_path):
    """Columns that hold no numbers, and empty cells, are refused by name."""
    parquet(tmp_path / "log.parquet", **changes)
    with pytest.raises(BadDataset, match=text):
        load_dataset(tmp_path / "log.parquet")


@pytest.mark.parametrize("suffix", [".npz", ".parquet"])
@pytest.mark.parametrize("content", [b"", b"not a file of this kind", b"PK\x03\x04 cut off", b"PAR1PAR1"])
def test_unreadable_files(suffix, content, tmp_path):
    """Whatever bytes a file holds, the answer is a BadDataset that names it."""
    path = tmp_path / f"log{suffix}"
    path.write_bytes(content)
    with pytest.raises(BadDataset, match=rf"log\{suffix}: the file cannot be read as (\.npz|Parquet) "):
        load_dataset(path)


@pytest.mark.filterwarnings("ignore")  # the zip reader warns of some damage before it raises
@pytest.mark.parametrize("suffix", [".npz", ".csv", ".parquet"])
def test_damaged_files(suffix, tmp_path):
    """Whichever bytes are damaged, a file loads or is refused as a BadDataset; no other error ever escapes."""
    rng = np.random.default_rng(0)
    path, rows = tmp_path / f"log{suffix}", np.arange(12.0)
    numbers = rng.normal(size=(3, 12, 2))
    save_dataset(Dataset([Episode("a", rows, *numbers, robot="r")], metadata=Metadata(notes="n")), path)
    whole, refused = np.frombuffer(path.read_bytes(), np.uint8), []
    for _ in range(300):
        damaged = whole.copy()
        damaged[rng.integers(len(whole), size=2)] = rng.integers(256, size=2)
        path.write_bytes(damaged.tobytes())
        try:
            load_dataset(path)
        except BadDataset as error:
            refused.append(str(error))
    assert len(refused) > 30
    assert all(text.startswith(f"{path}: ") for text in refused)


def test_changed_numbers_in_parquet_are_noticed(tmp_path):
    """A number that changed on the disk fails the page's checksum."""
    path = tmp_path / "log.parquet"
    numbers = np.random.default_rng(0).normal(size=(12, 1))
    save_dataset(Dataset([Episode("a", np.arange(12), numbers, numbers + 1, numbers + 2)]), path)
    content = path.read_bytes()
    place = content.index(numbers[5].tobytes())
    path.write_bytes(content[:place] + b"\0" + content[place + 1 :])
    with pytest.raises(BadDataset, match=r"cannot be read as Parquet .*CRC"):
        load_dataset(path)


def test_cut_off_npz(tmp_path):
    """A .npz of which the last bytes are missing is refused."""
    np.savez(tmp_path / "log.npz", **good())
    whole = (tmp_path / "log.npz").read_bytes()
    for length in (10, len(whole) // 2, len(whole) - 30):
        (tmp_path / "log.npz").write_bytes(whole[:length])
        with pytest.raises(BadDataset, match="cannot be read as"):
            load_dataset(tmp_path / "log.npz")


def test_single_array_under_npz(tmp_path):
    """A lone array saved under the suffix .npz is refused with the remedy."""
    with (tmp_path / "log.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(BadDataset, match=r"holds a single array; a \.npz archive of named arrays is needed"):
        load_dataset(tmp_path / "log.npz")


def test_paths(tmp_path):
    """Unknown suffix, absent file, absent folder: each says so and lists the choices."""
    (tmp_path / "log.bag").write_text("")
    with pytest.raises(BadDataset, match=r"log\.bag: unknown suffix '\.bag'; known are \.npz, \.csv, \.parquet"):
        load_dataset(tmp_path / "log.bag")
    with pytest.raises(BadDataset, match=r"log\.npz: the file does not exist"):
        load_dataset(tmp_path / "log.npz")
    for name in ("none", "none.bag"):
        with pytest.raises(
            BadDataset, match=rf"{name}: the file or folder does not exist; give the path of recordings"
        ):
            load_dataset(tmp_path / name)
    data = Dataset([Episode("a", [0, 1], [[1], [2]], [[1], [2]], [[], []])])
    with pytest.raises(BadDataset, match=r"unknown suffix '\.pkl'; known are \.npz, \.csv, \.parquet"):
        save_dataset(data, tmp_path / "log.pkl")
    with pytest.raises(BadDataset, match="the folder to save in does not exist; create it first"):
        save_dataset(data, tmp_path / "absent" / "log.npz")


def test_folders(tmp_path):
    """A folder without data, of two formats, of unlike columns or of contradicting metadata is refused."""
    with pytest.raises(BadDataset, match=r"data files of one format \(\.npz, \.csv, \.parquet\); found: none"):
        load_dataset(tmp_path)
    (tmp_path / "hopper_observations.npy").touch()
    with pytest.raises(BadDataset, match=r"Call load_dropo\(folder, qpos=\[\.\.\.\], qvel=\[\.\.\.\], control_dt="):
        load_dataset(tmp_path)
    (tmp_path / "a.csv").write_text(HEAD + "0,0,1,2,3\n0,1,1,2,3\n")
    (tmp_path / "b.csv").write_text(HEAD.replace("ctrl_0", "ctrl_m") + "0,0,1,2,3\n0,1,1,2,3\n")
    with pytest.raises(BadDataset, match=r"b\.csv and a\.csv name their columns differently"):
        load_dataset(tmp_path)
    (tmp_path / "b.csv").write_text(HEAD + "0,0,1,2,3\n0,1,1,2,3\n")
    (tmp_path / "b.meta.json").write_text('{"solver": "CG"}')
    with pytest.raises(BadDataset, match=r"b\.csv: the metadata's solver is 'CG', in the files before it None"):
        load_dataset(tmp_path)
    np.savez(tmp_path / "c.npz", **good())
    with pytest.raises(BadDataset, match=r"found: \.csv, \.npz"):
        load_dataset(tmp_path)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_tables_without_velocities_are_not_written(tmp_path, suffix):
    """Recordings without velocities, of a first-order system, go into .npz only, and come back."""
    still = Dataset([Episode("a", [0, 0.1], [[1.0], [2.0]], np.empty((2, 0)), [[0.0], [0.0]])])
    with pytest.raises(BadDataset, match=r"these recordings have none; save them as \.npz"):
        save_dataset(still, tmp_path / f"x{suffix}")
    save_dataset(still, tmp_path / "x.npz")
    assert load_dataset(tmp_path / "x.npz").content_hash() == still.content_hash()
