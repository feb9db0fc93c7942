"""Names the code that a measurement depends on by its content, so that parts of two codes never end up in one table."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Callable, Iterable
from functools import cache
from importlib.util import find_spec
from pathlib import Path

PACKAGE = Path(__file__).parents[1]

TEXTS = (".py", ".xml", ".toml")
"""Files that count in a folder."""


@cache
def code_of(*places: str) -> str:
    """16 hex digits that change with the text of the files that a measurement depends on.

    Args:
        places: files and folders of this package; those that they import count too.
    """
    return digest_of(with_imports(files_in(places)))


def built_solver() -> str:
    """12 hex digits of the built solver of exact optimal transport, which has no text here."""
    spec = find_spec("nfpde._rust_ot")
    if spec is None or spec.origin is None:
        raise RuntimeError("the solver is not built")
    return hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()[:12]


def digest_of(files: Iterable[Path]) -> str:
    """16 hex digits of names and content."""
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(f"{path.relative_to(PACKAGE).as_posix()}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def files_in(places: Iterable[str]) -> list[Path]:
    """The files among places, and those in the folders among them."""
    paths = [PACKAGE / place for place in places]
    return [p for path in paths for p in ([path] if path.is_file() else path.rglob("*")) if p.suffix in TEXTS]


def with_imports(files: Iterable[Path], left_out: Callable[[Path], bool] = lambda path: False) -> set[Path]:
    """Files of this package, what they import, what that imports, and so on, but for some, and what these import."""
    found: set[Path] = set()
    waiting = [*files]
    while waiting:
        path = waiting.pop()
        if path not in found and not left_out(path):
            found.add(path)
            waiting += _imports(path) if path.suffix == ".py" else []
    return found


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
