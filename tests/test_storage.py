"""Files that are whole or not there, and JSON files of a stated version."""

import errno
import json
import math
import os
import signal
import subprocess
import sys
import threading

import pytest

from nfpde.errors import BadInput
from nfpde.storage import alone_in, finite, read_json, write_whole


def test_content_comes_back_and_nothing_else_is_left(tmp_path):
    """Bytes as they are, text as UTF-8, an older file replaced."""
    path = tmp_path / "a.bin"
    for content in (b"\x00\xff", b"shorter\n", "Grüße\n"):
        write_whole(path, content)
        assert path.read_bytes() == (content if isinstance(content, bytes) else content.encode("utf-8"))
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("function", ["fsync", "replace"])
def test_a_write_that_fails_leaves_the_old_file(tmp_path, monkeypatch, function):
    """A full disk or a kill before the rename: the old content is still there."""
    path = tmp_path / "a.json"
    write_whole(path, "old")

    def fails(*_):
        raise OSError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr(os if function == "fsync" else type(path), function, fails)
        with pytest.raises(OSError, match="disk full"):
            write_whole(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("function", ["fsync", "replace"])
def test_the_error_of_a_write_names_the_file(tmp_path, monkeypatch, function):
    """Number and words of the system, and the file that was asked for, not the one beside it."""
    path = tmp_path / "a.json"

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os if function == "fsync" else type(path), function, full)
    with pytest.raises(OSError, match=r"No space left on device: '.*/a\.json'$") as raised:
        write_whole(path, "new")
    assert (raised.value.errno, raised.value.strerror) == (errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert (raised.value.filename, raised.value.filename2) == (str(path), None)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_missing_is_named(tmp_path):
    """The error is of the kind that it was, of the file that was asked for."""
    with pytest.raises(FileNotFoundError) as raised:
        write_whole(tmp_path / "none" / "a.json", "new")
    assert raised.value.filename == str(tmp_path / "none" / "a.json")


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_a_write_that_is_stopped_leaves_nothing(tmp_path, monkeypatch, stop):
    """Ctrl-C, or anything else: no part of a file is left, and the reason comes through."""

    def stopped(*_):
        raise stop

    monkeypatch.setattr(os, "fsync", stopped)
    with pytest.raises(stop):
        write_whole(tmp_path / "a.json", "new")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (None, r"a\.json cannot be read \(No such file or directory\); look again$"),
        ("{", r"a\.json is not JSON: "),
        ('"text"', r"a\.json: schema_version is None, this version of nfpde reads 2; write it again$"),
        ('{"schema_version": 1}', r"a\.json: schema_version is 1, this version of nfpde reads 2; write it again$"),
        ("[2]", "schema_version is None"),
    ],
)
def test_files_that_are_refused(tmp_path, content, text):
    """Missing, damaged, of another version: the message names the file and ends with what to do."""
    path = tmp_path / "a.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(BadInput, match=text):
        read_json(path, 2, missing="; look again", outdated="; write it again")


def test_the_right_version_is_read(tmp_path):
    """The object comes back as it was written."""
    content = {"schema_version": 2, "name": "Grüße", "values": [1.5, None]}
    write_whole(tmp_path / "a.json", json.dumps(content, ensure_ascii=False))
    assert read_json(tmp_path / "a.json", 2) == content


def test_what_json_cannot_hold_becomes_null():
    """Infinity and NaN at any depth become None; everything else stays as it is."""
    value = {"a": [1.5, math.inf, (math.nan, "x")], "b": {"c": -math.inf, "d": None, "e": True}}
    assert finite(value) == {"a": [1.5, None, [None, "x"]], "b": {"c": None, "d": None, "e": True}}


HOLDER = """
import sys, time
from pathlib import Path
from nfpde.storage import alone_in

with alone_in(Path(sys.argv[1]), "a job"):
    print("inside", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_a_folder_is_of_one_process_at_a_time(tmp_path, end):
    """The second is told so, with the folder; once the first has ended, in whatever way, the folder is free."""
    folder = tmp_path / "inner" / "out"
    signal.signal(signal.SIGINT, signal.default_int_handler)
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "inside\n"
    text = r"^training in .*/inner/out: another process is at work there; wait for its end"
    with pytest.raises(BadInput, match=text), alone_in(folder, "training"):
        pytest.fail("two are inside")
    holder.send_signal(end)
    holder.communicate(timeout=60)
    with alone_in(folder, "training"):
        assert [p.name for p in folder.iterdir()] == [".lock"]
    assert not (folder / ".lock").exists()


@pytest.mark.parametrize("kept", [None, "inner", "inner/out"])
def test_a_folder_in_which_nothing_was_written_is_taken_away(tmp_path, kept):
    """With those above it that were made for it; what was there stays, and what holds something."""
    folder = tmp_path / "inner" / "out"
    if kept is not None:
        (tmp_path / kept).mkdir(parents=True)
    with pytest.raises(KeyError), alone_in(folder, "work"):
        raise KeyError
    assert [str(p.relative_to(tmp_path)) for p in sorted(tmp_path.rglob("*"))] == {
        None: [],
        "inner": ["inner"],
        "inner/out": ["inner", "inner/out"],
    }[kept]
    with alone_in(folder, "work"):
        (folder / "result").write_text("done")
    assert (folder / "result").read_text() == "done"


def test_a_folder_is_of_one_thread_at_a_time(tmp_path):
    """Many that try again and again: never are two inside, and each has its turn, though the file comes and goes."""
    inside, turns, twice = [], [], []

    def work(name):
        while turns.count(name) < 30:
            try:
                with alone_in(tmp_path, "work"):
                    inside.append(name)
                    twice.extend(inside[1:])
                    turns.append(name)
                    inside.remove(name)
            except BadInput:
                continue

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert len(turns) == 120
    assert not twice


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    """A file in its place: the system's reason, and the path."""
    (tmp_path / "out").write_text("")
    with pytest.raises(FileExistsError) as raised, alone_in(tmp_path / "out", "work"):
        pytest.fail("inside a file")
    assert raised.value.filename == str(tmp_path / "out")
