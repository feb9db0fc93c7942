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
    """The stages of one cell; each is computed once, and all so far are written to `<name>.part.json` at once.

    Every stage keeps the settings and the code that it was computed with. It is used again where its settings are the
    same; and the code too, if the cell is not finished yet.

    Args:
        folder: of the cells.
        name: of the cell.
        facts: what the cell is, JSON.
        budget: checked before every stage.
        renew: name of a stage that must be of the code as it is now, while all others may be older, also in a
            finished cell; None for none.
    """

    def __init__(
        self, folder: Path, name: str, facts: dict[str, Any], budget: Budget, *, renew: str | None = None
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path, self.part = folder / f"{name}.json", folder / f"{name}.part.json"
        self.facts = json.loads(json.dumps(facts))
        self.budget, self.renew = budget, renew
        self.done: dict[str, Any] = {}
        self.asked: dict[str, None] = {}
        for path in (self.path, self.part):
            if path.is_file():
                self.done |= self._usable(read_json(path, SCHEMA_VERSION)["stages"], finished=path == self.path)

    def finished(self) -> dict[str, Any] | None:
        """The content of the finished file, where it is one of these facts and nothing in it must be renewed."""
        if not self.path.is_file():
            return None
        content = read_json(self.path, SCHEMA_VERSION)
        fresh = self.renew is None or content["stages"][self.renew]["provenance"] == provenance()
        return content if fresh and content["facts"] == self.facts else None

    def __call__(self, name: str, compute: Callable[[], Any], settings: Any = None) -> Any:
        """The stage's result, computed now or before.

        Args:
            name: of the stage.
            compute: gives plain JSON values.
            settings: what the result depends on, JSON; a stage with other ones is computed anew.

        Raises:
            OutOfTime: before it starts to compute.
        """
        settings = json.loads(json.dumps(settings))
        self.asked[name] = None
        if name not in self.done or self.done[name]["settings"] != settings:
            self.budget.check()
            # what is not finite becomes null
            result = json.loads(json.dumps(compute()), parse_constant=lambda _: None)
            self.done[name] = {"settings": settings, "provenance": provenance(), "result": result}
            write_whole(self.part, json.dumps(self._content()))
        return self.done[name]["result"]

    def finish(self) -> dict[str, Any]:
        """Write the finished file, with the stages that were asked for and in that order; returns its content."""
        self.done = {name: self.done[name] for name in self.asked}
        write_whole(self.path, json.dumps(self._content()) + "\n")
        self.part.unlink(missing_ok=True)
        return self._content()

    def _content(self) -> dict[str, Any]:
        return {"schema_version": SCHEMA_VERSION, "facts": self.facts, "stages": self.done}

    def _usable(self, stages: dict[str, Any], *, finished: bool) -> dict[str, Any]:
        kept = {}
        for name, stage in stages.items():
            any_code = finished if self.renew is None else name != self.renew
            if any_code or stage["provenance"] == provenance():
                kept[name] = stage
        return kept


def results(content: dict[str, Any]) -> dict[str, Any]:
    """The result of every stage of a file, by name."""
    return {name: stage["result"] for name, stage in content["stages"].items()}


def code_of(stage: dict[str, Any]) -> str:
    """The commit that a stage was computed with, short."""
    p = stage["provenance"]
    return (p["commit"] or "unknown")[:10] + (" with changes" if p["uncommitted"] else "")
