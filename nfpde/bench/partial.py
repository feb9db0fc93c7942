"""What a long measurement has so far, beside its table: where it was stopped, the same command goes on."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nfpde.storage import write_whole


class Partial:
    """Parts of a measurement by name, kept in a file until the measurement is whole.

    Args:
        path: the file; its folder must exist.
        facts: what was measured, how and where, as JSON. Parts that were measured otherwise are measured anew.
    """

    def __init__(self, path: Path, facts: dict[str, Any]) -> None:
        self._path, self._facts = path, json.loads(json.dumps(facts))
        self._parts: dict[str, Any] = {}
        if path.is_file():
            kept = json.loads(path.read_text(encoding="utf-8"))
            if kept["facts"] == self._facts:
                self._parts = kept["parts"]
                print(f"going on from {path}, which has {', '.join(self._parts)}; delete it to begin anew", flush=True)

    def get(self, name: str, measure: Callable[[], Any]) -> Any:
        """The part of that name, as JSON; measured if it is not there."""
        if name not in self._parts:
            self._parts[name] = json.loads(json.dumps(measure()))
            write_whole(self._path, json.dumps({"facts": self._facts, "parts": self._parts}, indent=1) + "\n")
        return self._parts[name]

    def finish(self) -> None:
        """Remove the file: the measurement is whole, and the next one begins anew."""
        self._path.unlink(missing_ok=True)
