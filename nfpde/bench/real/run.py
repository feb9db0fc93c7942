"""`nfpde bench real`: recordings of real robots against the diagnosis, one row each, beside what is known of them."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from nfpde.bench.code import code_of
from nfpde.bench.partial import Partial
from nfpde.bench.real.cases import CASES, Case
from nfpde.bench.real.table import line, table
from nfpde.errors import BadInput, NfpdeError
from nfpde.gap import GapReport, diagnose_gap, write_report
from nfpde.sim import Device, found_device
from nfpde.storage import finite, write_whole


def run(
    recordings: Path,
    out: Path,
    *,
    names: Sequence[str] = (),
    reports: Path | None = None,
    windows: int | None = None,
    device: Device = "auto",
    seed: int = 0,
    report: Callable[[str], None] = lambda what: None,
) -> list[dict[str, Any]]:
    """Diagnose each robot, print a table and write it to real.md and real.json.

    Where it was stopped, the same command goes on, as long as the code is the same.

    Args:
        recordings: folder with one of each source.
        out: folder for the table.
        names: of the cases, by what their names begin with; all of them if empty.
        reports: folder for report.html of every case; none without.
        windows: of every diagnosis; None for its own choice.
        device: where it simulates.
        seed: decides which episodes are held out.
        report: called with what is being done.

    Returns:
        One row a case.

    Raises:
        BadInput: no such case or device, or a folder of recordings that is not there.
    """
    device = found_device(device)
    cases = [case for case in CASES if not names or case.name.startswith(tuple(names))]
    _check(recordings, cases, names)
    facts = {
        "seed": seed,
        "windows": windows,
        "device": device,
        "versions": {name: version(name) for name in ("nfpde", "mujoco", "numpy", "scipy")},
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "code": code_of("bench/real", "gap"),
    }
    out.mkdir(parents=True, exist_ok=True)
    parts, rows = Partial(out / "real.part.json", facts), []
    settings = {"seed": seed, "windows": windows, "device": device}
    for case in cases:
        folder = None if reports is None else reports / case.name.replace(" ", "_")

        def tell(what: str, name: str = case.name) -> None:
            report(f"{name}: {what}")

        measure = partial(_row, case, recordings / case.place, folder, report=tell, **settings)
        rows.append({"name": case.name, "known": case.known, **parts.get(case.name, measure)})
        print(line(rows[-1]), flush=True)
    write_whole(out / "real.json", json.dumps({**facts, "rows": rows}, indent=1) + "\n")
    text = table(rows, facts)
    print(text)
    write_whole(out / "real.md", text)
    parts.finish()
    return rows


def _row(case: Case, folder: Path, page: Path | None, **settings: Any) -> dict[str, Any]:
    model, data = case.load(folder)
    told = {"episodes": len(data), "rows": data.nrow, "control_dt": data.control_dt}
    try:
        found = diagnose_gap(model, data, **settings)
    except NfpdeError as error:  # what it refuses is an answer, too
        return {**told, "refused": str(error)}
    if page is not None:
        found.save(page)
        write_report(found, page)
    return {**told, **_answer(found)}


def _answer(found: GapReport) -> dict[str, Any]:
    effects = [
        {
            "effect": cause.effect,
            "target": cause.target,
            "reading": cause.reading,
            "values": {name: asdict(value) for name, value in cause.parameters.items()},
            "rivals": [f"{rival.effect} {rival.target}".strip() for rival in cause.indistinguishable],
        }
        for cause in found.effects
    ]
    numbers = {"gap": asdict(found.gap), "distance": asdict(found.distance)}
    return finite(
        {
            "verdict": found.verdict,
            "effects": effects,
            **numbers,
            "million_steps": found.simulated_steps / 1e6,
            "seconds": found.seconds,
        }
    )


def _check(recordings: Path, cases: Sequence[Case], names: Sequence[str]) -> None:
    for name in names:
        if not any(case.name.startswith(name) for case in CASES):
            raise BadInput(f"no case begins with {name!r}; there are: {'; '.join(case.name for case in CASES)}")
    missing = sorted({case.place for case in cases if not (recordings / case.place).is_dir()})
    if missing:
        raise BadInput(f"{recordings} has no folder {missing[0]!r}; give the folder that has one of each source")
