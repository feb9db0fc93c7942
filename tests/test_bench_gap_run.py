"""The benchmark from end to end, with a diagnosis that is made up."""

import json
import math
import os
import pathlib
import signal
import subprocess
import sys
import time
from dataclasses import replace
from typing import Any

import pytest
from typer.testing import CliRunner

from nfpde.bench import code
from nfpde.bench.gap import cases as case_module
from nfpde.bench.gap import kept
from nfpde.bench.gap import run as bench
from nfpde.bench.gap.draw import draw_system
from nfpde.bench.gap.kept import fingerprint
from nfpde.bench.gap.score import Row
from nfpde.bench.gap.workers import shared_cores, workers
from nfpde.cli import app
from nfpde.errors import BadInput

STUB = """
import json, os, pathlib, sys
seen = sorted(p.name for p in pathlib.Path(".").iterdir())
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir()
answer = {"schema": 1, "verdict": "no_gap", "effects": [], "where": [], "simulated_steps": 5,
          "gap": {"before": 1.0, "after_effects": 0.5, "horizons": {}}, "seen": seen, "args": sys.argv[1:],
          "cwd": os.getcwd(), "environment": sorted(os.environ)}
(out / "diagnosis.json").write_text(json.dumps(answer))
"""


@pytest.fixture(scope="module")
def drawn():
    """One system."""
    return draw_system(31, 1)


@pytest.fixture
def quick(drawn, monkeypatch):
    """Every index is the same system: drawing is tested elsewhere."""

    def same(seed, index, kind=None):
        return replace(drawn, key={**drawn.key, "seed": seed, "index": index})

    monkeypatch.setattr(case_module, "draw_system", same)
    monkeypatch.setattr(bench, "draw_system", same)


@pytest.fixture
def stub(tmp_path):
    """A command that says "no gap" and what it saw."""
    path = tmp_path / "stub.py"
    path.write_text(STUB)
    return [sys.executable, str(path)]


def test_a_run_goes_from_systems_to_a_table_and_goes_on(stub, quick, tmp_path, monkeypatch):
    """Finished cases are kept; tables, rows and picture are there; the diagnosis saw public files only."""
    monkeypatch.setenv("SECRET_KEY_FOLDER", "somewhere")
    folder, out = tmp_path / "work", tmp_path / "out"
    rows = bench.run(31, out, cases=2, folder=folder, command=stub)
    assert [row.index for row in rows] == [0, 1]
    assert all(row.right == (row.kind == "none") for row in rows)
    assert {p.name for p in out.iterdir()} == {"gap.md", "gap.json", "gap.png"}
    content = json.loads((out / "gap.json").read_text())
    assert content["seed"] == 31
    assert len(content["rows"]) == 2
    answer = json.loads((folder / "answers" / "0000.json").read_text())["diagnosis"]
    assert set(answer["seen"]) <= {"data.npz", "log.txt", "model.xml", "parameters.toml"}
    assert not any("31" in a or "key" in a for a in answer["args"])
    assert str(tmp_path) not in answer["cwd"]
    assert "SECRET_KEY_FOLDER" not in answer["environment"]
    before = (folder / "answers" / "0001.json").stat().st_mtime_ns
    assert len(bench.run(31, out, cases=3, folder=folder, command=stub)) == 3
    assert (folder / "answers" / "0001.json").stat().st_mtime_ns == before


def test_the_diagnosis_is_told_its_device(stub, quick, tmp_path, capsys):
    """The device is passed on, the table has its name, and says what the diagnosis itself says it ran on."""
    path = pathlib.Path(stub[1])
    path.write_text(path.read_text().replace('"schema": 1,', '"schema": 1, "device": "warp-cpu: a stub",'))
    folder, out = tmp_path / "work", tmp_path / "out"
    bench.run(31, out, cases=1, folder=folder, command=stub, device="warp-cpu")
    answer = json.loads((folder / "answers" / "0000.json").read_text())["diagnosis"]
    assert answer["args"][:2] == ["--device", "warp-cpu"]
    page = (out / "gap_warp-cpu.md").read_text()
    assert "simulated on warp-cpu: a stub." in page
    assert "bench gap --seed 31 --cases 1 --limit 300 --device warp-cpu" in page
    unknown: Any = "tpu"
    with pytest.raises(BadInput, match="'tpu'; there are: auto, cpu, cuda, warp-cpu"):
        bench.run(31, out, cases=1, folder=folder, command=stub, device=unknown)


def test_a_table_may_be_of_one_kind(stub, tmp_path):
    """Sound robots alone: no key holds a fault; table and folder say so, and no other kind goes on there."""
    folder, out = tmp_path / "work", tmp_path / "out"
    rows = bench.run(31, out, cases=2, folder=folder, command=stub, kind="none")
    assert [row.kind for row in rows] == ["none", "none"]
    assert json.loads((folder / "keys" / "0000.json").read_text())["faults"] == []
    assert "bench gap --seed 31 --cases 2 --limit 300 --kind none`" in (out / "gap_none.md").read_text()
    with pytest.raises(BadInput, match="with kind 'none', this call has 'two'"):
        bench.run(31, tmp_path / "new", cases=1, folder=folder, command=stub, kind="two")
    with pytest.raises(BadInput, match="no kind 'three' of systems; there are: one, none, two, outsider"):
        bench.run(31, out, cases=1, command=stub, kind="three")


def test_a_diagnosis_that_fails_or_hangs_is_a_row(quick, tmp_path):
    """Exit status and time limit are named, and the benchmark goes on."""
    fails = [sys.executable, "-c", "raise SystemExit('it broke')"]
    hangs = [sys.executable, "-c", "import time; time.sleep(60)"]
    failed = bench.run(31, tmp_path / "a", cases=1, folder=tmp_path / "fails", command=fails)
    late = bench.run(31, tmp_path / "b", cases=1, folder=tmp_path / "hangs", command=hangs, limit=0.5)
    assert failed[0].reason == "exit status 1; it broke"
    assert late[0].reason == "time limit"
    assert late[0].seconds < 10


def test_the_key_is_written_after_the_diagnosis(stub, quick, tmp_path, monkeypatch):
    """While the diagnosis runs there is no key on the disk."""
    order = []
    real = case_module._diagnose
    monkeypatch.setattr(case_module, "_diagnose", lambda *a: (order.append((tmp_path / "keys").exists()), real(*a))[1])
    case = case_module.Case(31, 0, tmp_path, stub, 60.0)
    case_module.run_case(case)
    assert order == [False]
    assert case.key.is_file()
    assert (tmp_path / "keys").stat().st_mode & 0o777 == 0o700


def test_kept_cases_of_other_settings_are_refused(stub, quick, tmp_path):
    """A time limit changed half way would mix two benchmarks."""
    bench.run(31, tmp_path / "out", cases=1, folder=tmp_path / "work", command=stub)
    with pytest.raises(BadInput, match=r"limit 300\.0, this call has 5\.0"):
        bench.run(31, tmp_path / "new", cases=1, folder=tmp_path / "work", command=stub, limit=5.0)


def test_a_table_goes_on_without_its_folder(stub, quick, tmp_path, monkeypatch):
    """On another machine only what the committed table lacks is measured."""
    out = tmp_path / "out"
    first = bench.run(31, out, cases=2, folder=tmp_path / "here", command=stub)
    rows = bench.run(31, out, cases=3, folder=tmp_path / "there", command=stub)
    assert [p.name for p in (tmp_path / "there" / "answers").iterdir()] == ["0002.json"]
    assert [row.index for row in rows] == [0, 1, 2]
    assert rows[:2] == first
    assert f"code {fingerprint()}" in (out / "gap.md").read_text()
    monkeypatch.setattr(bench, "fingerprint", lambda device: "other")
    with pytest.raises(BadInput, match=r"with code '[0-9a-f]{16}', this call has 'other'"):
        bench.run(31, tmp_path / "new", cases=3, folder=tmp_path / "there", command=stub)


def test_an_interrupted_run_leaves_the_table_of_what_is_finished(stub, quick, tmp_path, monkeypatch):
    """Two of five systems are finished: the table has them and says so, and the same call goes on from there."""
    folder, out, run_case = tmp_path / "work", tmp_path / "out", bench.run_case

    def interrupted(case):
        if case.index == 2:
            raise KeyboardInterrupt
        return run_case(case)

    monkeypatch.setattr(bench, "run_case", interrupted)
    with pytest.raises(KeyboardInterrupt, match="2 of 5 systems are finished, from which the same call goes on"):
        bench.run(31, out, cases=5, folder=folder, command=stub)
    assert len(json.loads((out / "gap.json").read_text())["rows"]) == 2
    assert "Stopped after 2 of 5 systems." in (out / "gap.md").read_text()
    monkeypatch.setattr(bench, "run_case", run_case)
    assert [row.index for row in bench.run(31, out, cases=5, folder=folder, command=stub)] == [0, 1, 2, 3, 4]
    assert "Stopped" not in (out / "gap.md").read_text()


def test_an_interrupt_before_anything_is_finished_leaves_no_table(stub, quick, tmp_path, monkeypatch):
    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(bench, "run_case", interrupted)
    call = ["bench", "gap", "--seed", "31", "--cases", "2", "--folder", tmp_path / "work", "--out", tmp_path / "out"]
    result = CliRunner().invoke(app, [*map(str, call)])
    assert result.exit_code == 130
    assert "nfpde: the benchmark stopped; 0 of 2 systems are finished" in result.output
    assert "the same command goes on" in result.output
    assert not (tmp_path / "out").exists()


def test_rows_are_read_as_they_were_written(tmp_path):
    """An error without bound too, which JSON cannot hold."""
    row = Row(
        3, "one", "arm", ["a @ b"], [2.0], "done", errors={"x": math.inf, "y": 0.1}, inside={"x": False}, seconds=2
    )
    facts: dict[str, Any] = {**dict.fromkeys(kept.SAME, "same")}
    bench._write([row], facts | {"command": "c", "machine": "m", "device": "cpu", "cases": 1}, tmp_path, "gap")
    assert kept.kept_rows(tmp_path / "gap.json", facts) == {3: row}
    assert kept.kept_rows(tmp_path / "none.json", facts) == {}


def test_a_broken_table_is_named(stub, quick, tmp_path):
    """Half a file is no reason to measure everything again, nor to lose it unasked."""
    (tmp_path / "gap.json").write_text('{"seed": 31, "rows": [')
    with pytest.raises(BadInput, match=r"gap\.json is not JSON .*; delete it, or give another folder"):
        bench.run(31, tmp_path, cases=1, folder=tmp_path / "work", command=stub)


def test_the_fingerprint_is_of_what_decides(tmp_path, monkeypatch):
    """Faults and diagnosis count, names of files too, and what they import; the look of tables does not."""
    monkeypatch.setattr(code, "PACKAGE", tmp_path)

    def write(name, text, device="cuda"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
        return kept.fingerprint.__wrapped__(device)

    for name in ("flow/model.py", "flow/__init__.py", "losses.py", "ot.py"):
        write(name, "0")
    lazily = "def f():\n    from nfpde.losses import g, h\n    from nfpde.gap.words import summary\n"
    seen = [write("gap/diagnose.py", "1"), write("gap/diagnose.py", "from nfpde.gap.search import f")]
    seen += [write("gap/search.py", lazily), write("bench/gap/faults/wind.py", "1")]
    seen += [write("bench/gap/models/sled.xml", "a"), write("losses.py", "1")]
    seen += [write("losses.py", "from nfpde.flow import model\nimport nfpde.ot"), write("flow/model.py", "1")]
    seen += [write("ot.py", "from nfpde.sim import cpu, warp"), write("sim/warp.py", "from nfpde.kernels import new")]
    seen += [write("kernels/new.py", "")]
    assert len({*seen}) == len(seen) == 11
    for name in (
        "gap/html_report.py",
        "gap/words.py",
        "bench/gap/table.py",
        "bench/ot.py",
        "cli/bench.py",
        "rl/env.py",
        "gap/search.pyc",
        "flow/__init__.py",
    ):
        assert write(name, "1") == seen[-1]
    # a row that plain MuJoCo measured is none of Warp's
    before = write("sim/cpu.py", "1", "cpu")
    assert write("kernels/new.py", "2", "cpu") == write("sim/warp.py", "1", "cpu") == before
    assert write("sim/cpu.py", "from nfpde.sim import warp", "cpu") != before


def test_the_fingerprint_has_the_diagnosis_and_not_the_fit():
    names = {p.relative_to(code.PACKAGE).as_posix() for p in kept.deciding()}
    assert {"gap/answer.py", "bench/gap/score.py", "estimation/trajectory/student.py", "parameters.py"} <= names
    assert not {"gap/words.py", "gap/written.py", "gap/html_report.py"} & names
    assert not {"__init__.py", "bench/gap/table.py", "cli/bench.py", "estimation/fit.py", "flow/model.py"} & names
    warp = {"kernels/loss.py", "sim/warp.py", "sim/warp_batch.py"}
    assert not warp & names
    assert warp <= {p.relative_to(code.PACKAGE).as_posix() for p in kept.deciding("cuda")}


@pytest.mark.parametrize(("bad", "words"), [({"cases": 0}, "cases"), ({"jobs": 0}, "jobs"), ({"limit": -1.0}, "limit")])
def test_bad_arguments_are_named(bad, words, tmp_path):
    """Before anything is drawn."""
    with pytest.raises(BadInput, match=words):
        bench.run(1, tmp_path, folder=tmp_path / "work", **bad)


def test_keys_may_not_lie_among_the_systems(tmp_path):
    """Whoever gets the systems would get them."""
    with pytest.raises(BadInput, match="keys"):
        bench.draw_only(1, tmp_path, tmp_path / "keys", cases=1)


def test_the_command_draws_systems_to_develop_on(quick, tmp_path):
    """Public files and keys in two folders, no diagnosis."""
    call = ["bench", "gap", "--seed", "31", "--cases", "1", "--draw-only", "--folder", str(tmp_path)]
    result = CliRunner().invoke(app, call)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "systems" / "31-0000" / "model.xml").is_file()
    assert (tmp_path / "keys" / "31-0000.json").is_file()


ORPHAN = """
import multiprocessing, os, subprocess, sys, time
from concurrent.futures import ProcessPoolExecutor
from nfpde.bench.gap.workers import end_with_parent

def task():
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        print(os.getpid(), child.pid, flush=True)
        child.wait()
    except BaseException:
        child.kill()
        raise

if __name__ == "__main__":
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=end_with_parent) as pool:
        pool.submit(task).result()
"""


def _ended(pid):
    """Whether a process is gone, or waits to be buried."""
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.skipif(not pathlib.Path("/proc/self/stat").exists(), reason="looks at processes the way Linux shows them")
def test_workers_end_with_a_killed_run(tmp_path):
    """Where a run is killed its worker stops, and so does the diagnosis that it waits for."""
    script = tmp_path / "run.py"
    script.write_text(ORPHAN)
    run = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert run.stdout is not None
    pids = [int(word) for word in run.stdout.readline().split()]
    assert len(pids) == 2
    assert not any(_ended(pid) for pid in pids)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    until = time.monotonic() + 30  # at once on an idle machine, and five seconds of grace
    while not all(_ended(pid) for pid in pids) and time.monotonic() < until:
        time.sleep(0.05)
    assert all(_ended(pid) for pid in pids)


SLOW = """
import os, pathlib, sys, time
pathlib.Path(sys.argv[1], str(os.getpid())).touch()
time.sleep(120)
"""


@pytest.mark.skipif(not pathlib.Path("/proc/self/stat").exists(), reason="looks at processes the way Linux shows them")
def test_an_interrupt_stops_all_jobs(tmp_path):
    """Two diagnoses run and three wait: one signal to the run ends it and both, and none of the others begins."""
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "pids").mkdir()
    command = [sys.executable, str(tmp_path / "slow.py"), str(tmp_path / "pids")]
    (tmp_path / "run.py").write_text(
        "from pathlib import Path\nfrom nfpde.bench.gap.run import run\n"
        f"if __name__ == '__main__':\n    here = Path({str(tmp_path)!r})\n"
        f"    run(31, here / 'out', cases=5, jobs=2, folder=here / 'work', command={command!r})\n"
    )
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have told its children to ignore it
    call = [sys.executable, str(tmp_path / "run.py")]
    process = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    def begun():
        return [int(p.name) for p in (tmp_path / "pids").iterdir()]

    until = time.monotonic() + 600  # drawing two systems, on a machine that is busy
    while len(begun()) < 2 and time.monotonic() < until:
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert "KeyboardInterrupt: the benchmark stopped; 0 of 5 systems are finished" in said
    assert len(begun()) == 2
    assert all(_ended(pid) for pid in begun())


def cores_of_a_worker(folder):
    """Waits until two processes do: neither takes both tasks."""
    (folder / str(os.getpid())).touch()
    until = time.monotonic() + 60
    while len(list(folder.iterdir())) < 2 and time.monotonic() < until:
        time.sleep(0.05)
    return sorted(os.sched_getaffinity(0))


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system binds no process to cores")
def test_every_worker_has_cores_of_its_own(tmp_path):
    """Shares are alike in size, apart, and all there is; with more workers than cores each has one."""
    mine = sorted(os.sched_getaffinity(0))
    for jobs in (1, 2, 3, len(mine) + 1):
        shares = shared_cores(jobs)
        sizes = [len(share) for share in shares]
        assert len(shares) == jobs
        assert set().union(*shares) == set(mine)
        assert max(sizes) - min(sizes) <= 1
        assert sum(sizes) == max(len(mine), jobs)
    with workers(2) as pool:
        found = list(pool.map(cores_of_a_worker, [tmp_path, tmp_path]))
    assert sorted(found) == sorted(sorted(share) for share in shared_cores(2))
    assert sorted(os.sched_getaffinity(0)) == mine
