"""Which code a table is of, and rows of an earlier table that need not be measured again."""

from __future__ import annotations

import ast
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

DECIDES = ("bench/gap", "dataset", "effects", "gap", "kernels", "sim")
"""Folders of what draws the systems, answers, and judges; files elsewhere count if one of these imports them."""

SHOWS = ("__init__.py", "curve.py", "kept.py", "run.py", "summary.py", "table.py", "workers.py")
"""Here: what shows answers, or has them made."""

SAME = ("seed", "limit", "diagnosis", "versions", "code")
"""Facts that two tables must share if a row of one is to stand in the other."""


ON_WARP = ("kernels/", "sim/warp")
"""What the names of files begin with that a diagnosis on plain MuJoCo never runs."""


@cache
def fingerprint(device: str = "cpu") -> str:
    """16 hex digits that change with the text of any file that a row measured on a device depends on."""
    digest = hashlib.sha256()
    for path in sorted(deciding(device)):
        digest.update(f"{path.relative_to(PACKAGE).as_posix()}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def deciding(device: str = "cpu") -> set[Path]:
    """The files that a row depends on: those of `DECIDES`, what they import, what that imports, and so on.

    Args:
        device: where it was measured; MuJoCo Warp decides nothing on `cpu`.
    """
    found: set[Path] = set()
    waiting = [p for folder in DECIDES for p in (PACKAGE / folder).rglob("*") if p.suffix in (".py", ".xml", ".toml")]
    waiting = [p for p in waiting if p.parent != PACKAGE / "bench" / "gap" or p.name not in SHOWS]
    while waiting:
        path = waiting.pop()
        if path not in found and not (device == "cpu" and _on_warp(path)):
            found.add(path)
            waiting += _imports(path) if path.suffix == ".py" else []
    return found


def _on_warp(path: Path) -> bool:
    return path.relative_to(PACKAGE).as_posix().startswith(ON_WARP)


def _imports(path: Path) -> list[Path]:
    """Files of this package that a file imports by name, wherever in it; packages above them have no part."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and not node.level and node.module:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    return [file for name in names if name.startswith("nfpde.") and (file := _file_of(name.split(".")[1:]))]


def _file_of(parts: list[str]) -> Path | None:
    """The file of a module, or of the module that has the name in it."""
    for end in (len(parts), len(parts) - 1):
        place = PACKAGE.joinpath(*parts[:end])
        for file in (place.with_suffix(".py"), place / "__init__.py"):
            if end and file.is_file():
                return file
    return None


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
