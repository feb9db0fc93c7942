"""Files that are whole or not there at all, folders of one process at a time, JSON files of a stated version."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from nfpde.errors import BadInput


def write_whole(path: Path, data: bytes | str) -> None:
    """Replace a file at once: a kill at any moment leaves the old one or the new one, never a part.

    The data is written beside `path`, brought to the disk, then renamed. A write that fails leaves nothing new; a
    process that is killed may leave `<name>.<process>.tmp` behind.

    Args:
        path: the file; its folder must exist.
        data: the content; text is written as UTF-8.

    Raises:
        OSError: the system's reason (a full disk, a folder that is missing or read-only), with `path` as its
            `filename`.
    """
    temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    content = data.encode() if isinstance(data, str) else data
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError) and error.errno is not None:
            # writing and syncing name no file, opening and renaming the temporary one
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise
    with contextlib.suppress(OSError):  # some systems cannot sync a folder
        descriptor = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


LOCK_FILE = ".lock"

ATTEMPTS = 10
"""To open a file in a folder that others make and take away."""


@contextmanager
def alone_in(folder: Path, what: str) -> Iterator[None]:
    """Within the block no other process, and no other thread, is in such a block for the same folder.

    The system gives the lock back when the process ends, however it ends. Where it has no such locks (some network
    drives, Windows) nobody is kept out.

    Args:
        folder: made where it is missing, and taken away again if nothing is left in it; holds `.lock` within the block.
        what: what is done in it, with which the message of an error begins: "training".

    Raises:
        BadInput: somebody else is in such a block.
        OSError: the folder cannot be made or written into; it is the `filename`.
    """
    missing = [f for f in (folder, *folder.parents) if not f.exists()]
    path = folder / LOCK_FILE
    file = _locked(path)
    while file is not None and not _is_at(file, path):  # whoever had it before has removed it meanwhile
        file.close()
        file = _locked(path)
    if file is None:
        raise BadInput(
            f"{what} in {folder}: another process is at work there; wait for its end, or give another folder"
        )
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        file.close()
        with contextlib.suppress(OSError):  # until one that holds something
            for made in missing:
                made.rmdir()


def _locked(path: Path) -> BinaryIO | None:
    """The file, made with its folder where it is missing, open and locked; None where somebody else has locked it."""
    file = _opened(path)
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        return None
    except (ImportError, OSError):  # no such locks here
        pass
    return file


def _opened(path: Path, attempts: int = ATTEMPTS) -> BinaryIO:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("ab")
    except OSError as error:
        # whoever had made the folder may have taken it away meanwhile
        if isinstance(error, FileNotFoundError) and attempts > 1:
            return _opened(path, attempts - 1)
        raise OSError(error.errno, error.strerror, str(path.parent)) from None


def _is_at(file: BinaryIO, path: Path) -> bool:
    """Whether an open file is the one that now lies at a path."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


class Picture(Protocol):
    """What draws itself into a file, such as a figure of matplotlib."""

    def savefig(self, fname: Any, /, *, dpi: float, format: str) -> object:
        """Draw into an open file."""
        ...


def write_picture(path: Path, figure: Picture, dpi: float) -> Path:
    """Draw a figure into a PNG file, which is replaced at once; see `write_whole`.

    Args:
        path: the file; its folder must exist.
        figure: what is drawn.
        dpi: pixels per inch.

    Returns:
        The path.

    Raises:
        OSError: as `write_whole`.
    """
    picture = BytesIO()
    figure.savefig(picture, dpi=dpi, format="png")
    write_whole(path, picture.getvalue())
    return path


def finite(value: Any) -> Any:
    """A JSON value without infinity and NaN, which JSON does not have: they become null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value


def read_json(path: Path, schema_version: int, *, missing: str = "", outdated: str = "") -> dict[str, Any]:
    """Read a JSON object whose entry `schema_version` is the one wanted.

    Args:
        path: the file.
        schema_version: the version that is understood.
        missing: ends the message where the file cannot be read: what to do.
        outdated: the same where it is of another version.

    Raises:
        BadInput: the file cannot be read, is not JSON, or is of another version.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}){missing}") from None
    except ValueError as error:
        raise BadInput(f"{path} is not JSON: {error}") from None
    version = content.get("schema_version") if isinstance(content, dict) else None
    if version != schema_version:
        raise BadInput(f"{path}: schema_version is {version!r}, this version of nfpde reads {schema_version}{outdated}")
    return content
