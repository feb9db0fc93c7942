"""One case: draw a system, let the diagnosis see its public files alone, keep what it says."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nfpde.bench.gap.draw import draw_system
from nfpde.bench.gap.store import read_key, write_key, write_public
from nfpde.storage import write_whole

KEPT_VARIABLES = (
    *("PATH", "HOME", "LANG", "LD_LIBRARY_PATH", "PYTHONPATH", "VIRTUAL_ENV", "TMPDIR", "WARP_CACHE_PATH"),
    "CUDA_VISIBLE_DEVICES",
)
"""What the diagnosis gets of the environment."""


@dataclass(frozen=True)
class Case:
    """One case of a run.

    Attributes:
        seed: seed of the run.
        index: number of the case.
        folder: folder of the run; answers go to `answers/`, keys to `keys/`.
        command: the diagnosis; model, recordings and options follow it.
        limit: wall time after which the diagnosis is stopped [s].
        kind: kind of the systems, see `draw.KINDS`; None: those whose turn it is.
    """

    seed: int
    index: int
    folder: Path
    command: Sequence[str]
    limit: float
    kind: str | None = None

    @property
    def answer(self) -> Path:
        """What the diagnosis said; there when the case is finished."""
        return self.folder / "answers" / f"{self.index:04d}.json"

    @property
    def key(self) -> Path:
        """The key; written after the diagnosis has ended."""
        return self.folder / "keys" / f"{self.index:04d}.json"


def finished(case: Case) -> bool:
    """Whether the case need not run again."""
    return case.answer.is_file() and case.key.is_file()


def outcome(case: Case) -> tuple[dict[str, Any], dict[str, Any]]:
    """Key and answer of a finished case."""
    return read_key(case.key), json.loads(case.answer.read_text(encoding="utf-8"))


def run_case(case: Case) -> int:
    """Run one case; returns its number.

    The diagnosis works in a fresh folder under a name that says nothing, with the public files and nothing else. The
    key does not exist on the disk until it has ended.
    """
    system = draw_system(case.seed, case.index, case.kind)
    home = Path(tempfile.mkdtemp(prefix="system-"))
    try:
        write_public(system.xml, system.free, system.robot, system.runs, home)
        answer = _diagnose(case.command, home, case.limit)
    finally:
        shutil.rmtree(home, ignore_errors=True)
    case.answer.parent.mkdir(parents=True, exist_ok=True)
    write_key(system.key, case.key)
    write_whole(case.answer, json.dumps(answer, indent=1))
    return case.index


def _diagnose(command: Sequence[str], home: Path, limit: float) -> dict[str, Any]:
    """Status, wall seconds and diagnosis.json of one call."""
    call = [*command, "model.xml", "data.npz", "--out", "report"]
    if (home / "parameters.toml").is_file():
        call += ["--params", "parameters.toml"]
    kept = {name: os.environ[name] for name in KEPT_VARIABLES if name in os.environ}
    environment = {**kept, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
    begun = time.monotonic()
    with (home / "log.txt").open("w") as log:
        process = subprocess.Popen(
            call, cwd=home, env=environment, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )
        try:
            code = process.wait(limit)
            status = "done" if code == 0 else f"exit status {code}"
        except BaseException as stop:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if not isinstance(stop, subprocess.TimeoutExpired):
                raise
            status = "time limit"
    seconds = time.monotonic() - begun
    answer: dict[str, Any] = {"status": status, "seconds": seconds, "diagnosis": None}
    if status == "done":
        try:
            answer["diagnosis"] = json.loads((home / "report" / "diagnosis.json").read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            answer["status"] = f"no diagnosis.json: {error}"
    if answer["status"] != "done":
        lines = (home / "log.txt").read_text(encoding="utf-8", errors="replace").strip().splitlines()
        answer["status"] += f"; {lines[-1][:200]}" if lines else ""
    return answer
