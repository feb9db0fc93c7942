"""Which code a table is of, and rows of an earlier table that need not be measured again."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from nfpde.bench import code
from nfpde.bench.gap.score import Row
from nfpde.errors import BadInput

DECIDES = ("bench/gap", "gap/diagnose.py")
"""What draws the systems and judges, and what answers; files elsewhere count if one of these imports them."""

SHOWS = ("__init__.py", "curve.py", "kept.py", "run.py", "summary.py", "table.py", "workers.py")
"""Here: what shows answers, or has them made."""

TELLS = ("gap/words.py", "gap/traces.py")
"""What writes an answer down once it stands."""

SAME = ("seed", "kind", "limit", "diagnosis", "versions", "code")
"""Facts that two tables must share if a row of one is to stand in the other."""


ON_WARP = ("kernels/", "sim/warp")
"""What the names of files begin with that a diagnosis on plain MuJoCo never runs."""


@cache
def fingerprint(device: str = "cpu") -> str:
    """16 hex digits that change with the text of any file that a row measured on a device depends on."""
    return code.digest_of(deciding(device))


def deciding(device: str = "cpu") -> set[Path]:
    """The files that a row depends on: those of `DECIDES`, what they import, what that imports, and so on.

    Args:
        device: where it was measured; MuJoCo Warp decides nothing on `cpu`.
    """
    here = code.PACKAGE / "bench" / "gap"
    files = [p for p in code.files_in(DECIDES) if p.parent != here or p.name not in SHOWS]
    idle = TELLS + (ON_WARP if device == "cpu" else ())
    return code.with_imports(files, lambda path: path.relative_to(code.PACKAGE).as_posix().startswith(idle))


def kept_rows(path: Path, facts: Mapping[str, Any]) -> dict[int, Row]:
    """Rows by number, from a table's JSON file.

    A table of hundreds of systems takes hours, and need not be measured in one go or on one machine.

    Args:
        path: of the table's JSON file, which need not exist.
        facts: of the table to be made, see `SAME`.

    Raises:
        BadInput: the file is not what a table writes, or of other code, systems or settings.
    """
    if not path.is_file():
        return {}
    try:
        old = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise BadInput(f"{path} is not JSON ({error}); delete it, or give another folder for the tables") from None
    for key in SAME:
        if old.get(key) != facts[key]:
            raise BadInput(
                f"{path} is a table with {key} {old.get(key)!r}, this one has {facts[key]!r}; give another folder for "
                "the tables, or move that table"
            )
    return {row["index"]: _read(row) for row in old["rows"]}


def _read(row: Mapping[str, Any]) -> Row:
    """A row as it was before what is not finite became null: the error of a value that nothing was said of."""
    return Row(**{**row, "errors": {name: math.inf if e is None else e for name, e in row["errors"].items()}})
