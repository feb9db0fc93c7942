"""Work that goes on where it stopped: one JSON file a cell, whole when done, its finished stages kept beside it."""

from __future__ import annotations

import json
import platform
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from nfpde.errors import BadInput
from nfpde.storage import read_json, write_whole

SCHEMA_VERSION = 1


class OutOfTime(Exception):
    """The time given is over; what is finished is on disk."""


@dataclass(frozen=True)
class Budget:
    """Minutes that a call may take, None without limit; a stage that has begun is finished."""

    minutes: float | None
    begun: float

    @classmethod
    def of(cls, minutes: float | None) -> Budget:
        """Starts now.

        Raises:
            BadInput: no positive number of minutes.
        """
        if minutes is not None and not minutes > 0:
            raise BadInput(f"the budget is {minutes:g} minutes; give a positive number, or leave it out")
        return cls(minutes, time.monotonic())

    def check(self) -> None:
        """Raises OutOfTime when it is over."""
        if self.minutes is not None and time.monotonic() - self.begun > 60 * self.minutes:
            raise OutOfTime


@cache
def provenance() -> dict[str, Any]:
    """Commit of the code as it was imported, files changed since, versions and machine; taken once a process."""
    versions = {name: version(name) for name in ("nfpde", "mujoco", "torch", "zuko", "numpy")}
    machine = f"{platform.machine()}, Python {platform.python_version()}"
    commit = _git("rev-parse", "HEAD")
    changed = _git("status", "--porcelain", "--", "nfpde", "rust_ot")
    return {
        "commit": commit,
        "uncommitted": None if changed is None else [line[3:] for line in changed.splitlines()],
        "versions": versions,
        "machine": machine,
    }


def _git(*arguments: str) -> str | None:
    """What git says about the folder of this package; None outside of a checkout."""
    here = Path(__file__).parents[3]
    try:
        done = subprocess.run(["git", "-C", str(here), *arguments], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.rstrip("\n")


class Stages:
    """The stages of one cell; each is computed once and written to `<name>.part.json` at once.

    Args:
        folder: of the cells.
        name: of the cell.
        facts: what the cell is, JSON. A finished file with other settings is done anew; finished stages also when
            the code is another.
        budget: checked before every stage.
    """

    def __init__(self, folder: Path, name: str, facts: dict[str, Any], budget: Budget) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path, self.part = folder / f"{name}.json", folder / f"{name}.part.json"
        self.facts = json.loads(json.dumps(facts))
        self.budget = budget
        self.done: dict[str, Any] = {}
        if self.part.is_file():
            old = read_json(self.part, SCHEMA_VERSION)
            if {k: old.get(k) for k in ("facts", "provenance")} == self._identity():
                self.done = old["stages"]

    def finished(self) -> dict[str, Any] | None:
        """The whole cell, where it was measured with these facts."""
        if not self.path.is_file():
            return None
        content = read_json(self.path, SCHEMA_VERSION)
        return content if content.get("facts") == self.facts else None

    def __call__(self, name: str, compute: Callable[[], Any]) -> Any:
        """The stage's result, computed now or before.

        Raises:
            OutOfTime: before it starts to compute.
        """
        if name not in self.done:
            self.budget.check()
            self.done[name] = json.loads(json.dumps(compute(), allow_nan=False))
            content = {"schema_version": SCHEMA_VERSION, **self._identity(), "stages": self.done}
            write_whole(self.part, json.dumps(content))
        return self.done[name]

    def finish(self, result: dict[str, Any]) -> dict[str, Any]:
        """Write the cell and forget its stages."""
        content = {"schema_version": SCHEMA_VERSION, **self._identity(), **result}
        write_whole(self.path, json.dumps(content, allow_nan=False) + "\n")
        self.part.unlink(missing_ok=True)
        return json.loads(json.dumps(content))

    def _identity(self) -> dict[str, Any]:
        return {"facts": self.facts, "provenance": provenance()}
