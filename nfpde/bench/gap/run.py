"""`nfpde bench gap`: hidden faults against the diagnosis; the table, its rows, the curve over size."""

from __future__ import annotations

import json
import math
import platform
import sys
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from nfpde.bench.gap.cases import Case, finished, outcome, run_case
from nfpde.bench.gap.curve import draw_curve
from nfpde.bench.gap.draw import KINDS, draw_system
from nfpde.bench.gap.kept import fingerprint, kept_rows
from nfpde.bench.gap.score import Row, judge
from nfpde.bench.gap.store import write_key, write_public
from nfpde.bench.gap.summary import faulty
from nfpde.bench.gap.table import summary, table
from nfpde.bench.gap.workers import stop, unless_ended, workers
from nfpde.errors import BadInput
from nfpde.progress import progress
from nfpde.storage import finite, write_whole

DIAGNOSE = (sys.executable, "-m", "nfpde", "diagnose")

QUICK_CASES = 12

DEVICES = ("auto", "cpu", "cuda", "warp-cpu")
"""Where a diagnosis may simulate."""


def run(
    seed: int,
    out: Path,
    *,
    cases: int = 300,
    jobs: int = 1,
    quick: bool = False,
    limit: float = 300.0,
    folder: Path | None = None,
    command: Sequence[str] = DIAGNOSE,
    device: str = "auto",
    kind: str | None = None,
) -> list[Row]:
    """Run all cases that are not finished, judge all, print a table, write gap.md, gap.json and the curve gap.png.

    Finished is what lies in the folder, and what a gap.json in `out` tells of the same systems, settings and code; all
    that it tells stays in the table. One of others is never replaced.

    Args:
        seed: seed of the systems; none that anything was tried on before.
        out: folder for the tables.
        cases: number of systems; the table has more where it had more before.
        jobs: systems at a time, each on a share of the cores.
        quick: 12 systems at most, tables named gap_quick.
        limit: wall time for one diagnosis [s]; longer is a failure.
        folder: where finished cases and keys are kept; None is runs/gap-SEED, or runs/gap-SEED-KIND.
        command: the diagnosis.
        device: where it simulates; the table of another one than the CPU is named gap_<device>.
        kind: of the systems, see `draw.KINDS`; tables are named gap_<kind>. None: each in turn, 60 % with one fault.

    Returns:
        One row a case.

    Raises:
        BadInput: cases or jobs below 1, a limit that is not positive, no such device or kind, or kept cases or a table
            of another seed, kind, command, limit or code.
        KeyboardInterrupt: after writing the table of what is finished.
    """
    _check(cases, jobs, limit)
    command = [*command, "--device", device] if device != "auto" else command  # what the diagnosis takes by itself
    if device not in DEVICES:
        raise BadInput(f"there is no device {device!r}; there are: {', '.join(DEVICES)}")
    if kind is not None and kind not in KINDS:
        raise BadInput(f"there is no kind {kind!r} of systems; there are: {', '.join(KINDS)}")
    device = "cpu" if device == "auto" else device
    folder = folder or default_folder(seed, kind)
    cases = min(cases, QUICK_CASES) if quick else cases
    facts = _facts(seed, limit, device) | {"kind": kind, "diagnosis": list(command[1:])}
    name = "_".join(["gap", *([kind] if kind else []), *([device] if device != "cpu" else []), *(["quick"] * quick)])
    kept = kept_rows(out / f"{name}.json", facts)
    settings = {"seed": seed, "kind": kind, "limit": limit, "command": list(command)}
    folder.mkdir(parents=True, exist_ok=True)
    _check_kept(folder, settings | {name: facts[name] for name in ("versions", "code")})
    total = max([cases, *(index + 1 for index in kept)])
    every = [Case(seed, index, folder, command, limit, kind) for index in range(total)]
    stopped = False
    try:
        _work([case for case in every[:cases] if not finished(case) and case.index not in kept], cases, jobs)
    except KeyboardInterrupt:
        stopped = True
    rows = [_row(c) if finished(c) else kept[c.index] for c in every if finished(c) or c.index in kept]
    if rows:
        ran_on = dict.fromkeys(row.device for row in rows if row.device) or [device]  # one that failed says nothing
        told = {
            "command": _command(seed, total, limit, quick, device, kind),
            "device": ", ".join(ran_on),
            "cases": total,
        }
        _write(rows, facts | told, out, name)
    if stopped:
        raise KeyboardInterrupt(
            f"the benchmark stopped; {len(rows)} of {total} systems are finished, from which the same call goes on"
        )
    return rows


def default_folder(seed: int, kind: str | None) -> Path:
    """Where the systems of a seed, all of one kind or of each in turn, are kept."""
    return Path("runs") / (f"gap-{seed}" if kind is None else f"gap-{seed}-{kind}")


def _row(case: Case) -> Row:
    key, answer = outcome(case)
    return judge(key, answer["status"], answer["seconds"], answer["diagnosis"])


def draw_only(seed: int, folder: Path, keys: Path, *, cases: int, start: int = 0, kind: str | None = None) -> None:
    """Write the public files of systems to `folder` and their keys to `keys`; run no diagnosis.

    Raises:
        BadInput: cases below 1, or keys inside the folder of the public files.
    """
    _check(cases, 1, 1.0)
    if folder.resolve() in (keys.resolve(), *keys.resolve().parents):
        raise BadInput(f"the keys ({keys}) may not lie in the folder of the systems ({folder}); give another folder")
    with progress("Drawing", cases) as report:
        for done, index in enumerate(range(start, start + cases), 1):
            system = draw_system(seed, index, kind)
            write_public(system.xml, system.free, system.robot, system.runs, folder / f"{seed}-{index:04d}")
            write_key(system.key, keys / f"{seed}-{index:04d}.json")
            report(done)


def _work(left: list[Case], total: int, jobs: int) -> None:
    done = total - len(left)
    with progress("Diagnosing", total, start=done) as report:
        if jobs == 1:
            for case in left:
                run_case(case)
                done += 1
                report(done)
            return
        with workers(jobs) as pool:
            try:
                for future in as_completed([pool.submit(unless_ended, run_case, case) for case in left]):
                    future.result()
                    done += 1
                    report(done)
            except BaseException:
                stop(pool)
                raise


def _check(cases: int, jobs: int, limit: float) -> None:
    if cases < 1 or jobs < 1:
        raise BadInput(f"cases and jobs must be at least 1, got cases={cases} and jobs={jobs}")
    if not (limit > 0 and math.isfinite(limit)):
        raise BadInput(f"the time limit must be a positive number of seconds, got {limit}")


def _check_kept(folder: Path, settings: dict[str, Any]) -> None:
    """Cases that were finished with other settings are not mixed with new ones."""
    path, plain = folder / "settings.json", json.loads(json.dumps(settings))
    if path.is_file():
        old = json.loads(path.read_text(encoding="utf-8"))
        for name, value in plain.items():
            if old.get(name) != value:
                raise BadInput(
                    f"{folder} holds cases run with {name} {old.get(name)!r}, this call has {value!r}; give another "
                    "folder, or delete that one"
                )
    write_whole(path, json.dumps(plain))


def _command(seed: int, cases: int, limit: float, quick: bool, device: str, kind: str | None) -> str:
    options = f" --kind {kind}" if kind else ""
    options += (f" --device {device}" if device != "cpu" else "") + (" --quick" if quick else "")
    return f"nfpde bench gap --seed {seed} --cases {cases} --limit {limit:g}{options}"


def _facts(seed: int, limit: float, device: str) -> dict[str, Any]:
    return {
        "seed": seed,
        "limit": limit,
        "code": fingerprint(device),
        "versions": {name: version(name) for name in ("nfpde", "mujoco", "numpy", "scipy")},
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
    }


def _write(rows: list[Row], facts: dict[str, Any], out: Path, name: str) -> None:
    out.mkdir(parents=True, exist_ok=True)
    plain = [{k: finite(v) for k, v in asdict(row).items()} for row in rows]
    write_whole(out / f"{name}.json", json.dumps({**facts, "summary": summary(rows), "rows": plain}, indent=1))
    text = table(rows, facts, f"{name}.png")
    print(text)
    write_whole(out / f"{name}.md", text)
    if faulty(rows):
        draw_curve(rows, out / f"{name}.png")
