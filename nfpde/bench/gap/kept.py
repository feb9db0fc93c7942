"""Which code a table is of, and rows of an earlier table that need not be measured again."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from nfpde.bench.gap.score import Row
from nfpde.errors import BadInput

PACKAGE = Path(__file__).parents[2]

NO_PART = ("bench", "cli", "rl")
"""Folders of the package without influence on what a diagnosis answers."""

SHOWS = ("__init__.py", "curve.py", "kept.py", "run.py", "summary.py", "table.py", "workers.py")
"""Here: what shows answers, or has them made. All else decides about the systems, and about what is right."""

SAME = ("seed", "limit", "diagnosis", "versions", "code")
"""Facts that two tables must share if a row of one is to stand in the other."""


@cache
def fingerprint() -> str:
    """16 hex digits that change with the text of any file that a row depends on."""
    files = [p for p in PACKAGE.rglob("*") if p.suffix in (".py", ".xml", ".toml") and _counts(p)]
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(f"{path.relative_to(PACKAGE).as_posix()}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _counts(path: Path) -> bool:
    parts = path.relative_to(PACKAGE).parts
    return parts[0] not in NO_PART or (parts[:2] == ("bench", "gap") and parts[2] not in SHOWS)


def kept_rows(path: Path, facts: Mapping[str, Any]) -> dict[int, Row]:
    """Rows by number, from a table's JSON file; none where it is of other code, systems or settings.

    A table of hundreds of systems takes hours, and need not be measured in one go or on one machine.

    Args:
        path: of the table's JSON file, which need not exist.
        facts: of the table to be made, see `SAME`.

    Raises:
        BadInput: the file is not what a table writes.
    """
    if not path.is_file():
        return {}
    try:
        old = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise BadInput(f"{path} is not JSON ({error}); delete it, or give another folder for the tables") from None
    if any(key not in old or old[key] != facts[key] for key in SAME):
        return {}
    return {row["index"]: _read(row) for row in old["rows"]}


def _read(row: Mapping[str, Any]) -> Row:
    """A row as it was before what is not finite became null: the error of a value that nothing was said of."""
    return Row(**{**row, "errors": {name: math.inf if e is None else e for name, e in row["errors"].items()}})
