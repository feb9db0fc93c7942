"""What benchmarks ask of the system and of their own code: fingerprints, and cores where no system binds processes."""

import json
import os

import pytest

from nfpde.bench import code, devices, losses_warp
from nfpde.benchmarks import robot
from nfpde.sim import MujocoSimulator
from nfpde.sim.cores import usable_cores


def test_code_is_named_by_what_runs(tmp_path, monkeypatch):
    """Files that are given, those of given folders, and what they import; nothing else."""
    monkeypatch.setattr(code, "PACKAGE", tmp_path)

    def write(name, text):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
        return code.code_of.__wrapped__("bench/fit.py", "kernels")

    (tmp_path / "bench").mkdir()
    (tmp_path / "losses.py").touch()
    seen = [write("bench/fit.py", "0"), write("bench/fit.py", "def f():\n    from nfpde.losses import g")]
    seen += [write("losses.py", "1"), write("kernels/loss.py", "0"), write("kernels/loss.py", "1")]
    assert len({*seen}) == 5
    for name in ("rl/train.py", "bench/ot.py", "kernels/loss.pyc"):
        assert write(name, "1") == seen[-1]


@pytest.mark.parametrize(
    ("places", "inside"),
    [
        (("bench/fit.py", "benchmarks"), {"estimation/nfpde.py", "estimation/trajectory/fit.py", "sim/cpu.py"}),
        (("bench/losses_warp.py", "kernels"), {"sim/warp.py", "kernels/loss.py", "sim/warp_bare.py"}),
        (("bench/devices.py", "kernels"), {"gap/diagnose.py", "bench/gap/draw.py", "estimation/fit.py", "sim/warp.py"}),
    ],
)
def test_what_is_measured_counts(places, inside):
    """Fits, simulators, kernels and diagnosis are among the code of the tables that measure them."""
    assert inside <= {p.relative_to(code.PACKAGE).as_posix() for p in code.with_imports(code.files_in(places))}


class Stopped(Exception):
    pass


@pytest.mark.parametrize(("bench", "name"), [(devices, "devices"), (losses_warp, "losses")])
def test_parts_of_other_code_are_measured_anew(tmp_path, monkeypatch, bench, name):
    """A stopped measurement goes on with the same code alone."""
    measured = []

    def measure(*_):
        measured.append(1)
        return {"rows": [], "device": "a device"}

    def stop(*_, **__):
        raise Stopped

    # the first part is measured, the second stops the command
    if bench is devices:
        monkeypatch.setattr(losses_warp, "run", measure)
        monkeypatch.setattr(devices, "collect", stop)
        monkeypatch.setattr(devices, "make_simulator", lambda *_, **__: None)
        monkeypatch.setattr(devices, "runs_on", lambda _: "a device")
    else:
        monkeypatch.setattr(losses_warp, "_in_its_own_process", measure)
        monkeypatch.setattr(losses_warp, "_starts", stop)
    for fingerprint, times in (("this", 1), ("this", 1), ("that", 2)):
        monkeypatch.setattr(bench, "code_of", lambda *_, fingerprint=fingerprint: fingerprint)
        with pytest.raises(Stopped):
            bench.run(True, tmp_path, "warp-cpu")
        kept = json.loads((tmp_path / f"{name}_warp-cpu_quick.part.json").read_text())
        assert (kept["facts"]["code"], len(kept["parts"]), len(measured)) == (fingerprint, 1, times)


def test_cores_where_no_process_is_bound(monkeypatch):
    """On macOS and Windows Python knows of no such thing: all cores are taken."""
    mine = usable_cores()
    if hasattr(os, "sched_getaffinity"):
        assert mine == len(os.sched_getaffinity(0))
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    for count, cores in ((6, 6), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda count=count: count)
        assert usable_cores() == cores
        pendulum = robot("pendulum")
        assert MujocoSimulator(pendulum.model, pendulum.space, check_influence=False).nthread == cores
