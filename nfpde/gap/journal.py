"""What was simulated, kept in a file, so that a diagnosis that was stopped goes on where it stood.

A diagnosis is decided by what it simulates and by its seed. The same call asks for the same predictions in the same
order: those that lie in the file are read instead, and all the rest follows from them.
"""

from __future__ import annotations

import os
import struct
import time
import zlib
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from nfpde.errors import NfpdeError
from nfpde.storage import alone_in

Array = NDArray[np.float64]

FILE = "unfinished.bin"

MOST = 1 << 33
"""Bytes that a file has at most, 8 GiB."""

PREDICTS = (
    *("dataset", "effects", "kernels", "sim", "elements.py", "parameters.py"),
    *(f"gap/{name}.py" for name in ("identity", "inertia", "journal", "recall", "replay")),
)
"""What of this package makes predictions: a file that code of other text wrote is not read."""

_PACKAGES = ("mujoco", "mujoco-warp", "warp-lang", "numpy")
"""Others, whose versions count."""

_NAME = 16
"""Bytes of a name."""

_ENTRY = struct.Struct(f"<{_NAME}sdQI")
"""Before the numbers of an entry: its name, seconds that all was open until then, how many they are, their checksum."""


class Journal:
    """Predictions by name in the file `unfinished.bin` of a folder, within a `with` block.

    The file goes with the end of the block, and with an error of this package's. It stays where Ctrl-C, a kill or a
    failure end it, and the next block goes on with it, unless another version of the package or of MuJoCo wrote it.

    Args:
        folder: of the results.
        report: told where nothing more can be kept.
        most: bytes of the file.

    Attributes:
        seconds: that earlier blocks have taken for what the file holds.

    Raises:
        BadInput: another process is at work in the folder.
        OSError: the file cannot be opened or read.

    Example:
        An answer that is written before the file goes:
        `with Journal(out) as journal: diagnose_gap(model, data, space, journal=journal).save(out)`
    """

    def __init__(self, folder: Path | str, report: Callable[[str], None] = lambda what: None, most: int = MOST) -> None:
        self.path, self._report, self._most = Path(folder) / FILE, report, most
        self._at: dict[bytes, tuple[int, int, int]] = {}
        self._file: FileIO | None = None
        self._alone = ExitStack()
        self._end, self._full = 0, False
        self.seconds, self._begun = 0.0, 0.0

    def __enter__(self) -> Self:
        with ExitStack() as alone:
            alone.enter_context(alone_in(self.path.parent, "diagnosing"))
            self._file, head = alone.enter_context(self.path.open("a+b", buffering=0)), _head()
            self._end = len(head)
            if _read(self._file, 0, len(head)) != head:
                self._file.truncate(0)
                self._file.write(head)
            self._at = self._entries(self._file)
            self._file.truncate(self._end)  # without what a kill left of an entry
            self._alone, self._begun = alone.pop_all(), time.monotonic()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._alone:
            if self._file is not None:  # some systems remove no file that is open
                self._file.close()
                self._file = None
            if kind is None or issubclass(kind, NfpdeError):
                self.path.unlink(missing_ok=True)
        if kind is not None and issubclass(kind, KeyboardInterrupt) and self._at:
            raise KeyboardInterrupt(
                f"the diagnosis stopped; {self.path} holds what it has simulated, from which the same call goes on"
            ) from None

    def get(self, name: bytes) -> Array | None:
        """The numbers (n,) under a name of 16 bytes; None where there are none, or the disk has damaged them."""
        if self._file is None or name not in self._at:
            return None
        start, count, checksum = self._at[name]
        data = _read(self._file, start, 8 * count)
        return np.frombuffer(data) if zlib.crc32(data) == checksum else None

    def put(self, name: bytes, numbers: Array) -> None:
        """Keep numbers of any shape under a name of 16 bytes, as long as the file and the disk have room."""
        if self._file is None or self._full or not numbers.size:
            return
        data = np.ascontiguousarray(numbers, np.float64).tobytes()
        seconds, checksum = self.seconds + time.monotonic() - self._begun, zlib.crc32(data)
        entry = _ENTRY.pack(name, seconds, numbers.size, checksum) + data
        if self._end + len(entry) > self._most:
            self._stop(f"{self.path} has {self._end / 1e9:.2g} GB")
            return
        try:
            written = self._file.write(entry)
        except OSError as error:
            self._stop(f"{self.path}: {error.strerror}")
            return
        if written < len(entry):
            self._file.truncate(self._end)
            self._stop(f"{self.path}: the disk is full")
            return
        self._at[name] = self._end + _ENTRY.size, numbers.size, checksum
        self._end += len(entry)

    def _entries(self, file: FileIO) -> dict[bytes, tuple[int, int, int]]:
        """What lies where, up to an entry that is not whole; the end is behind them then."""
        size, found = file.seek(0, os.SEEK_END), dict[bytes, tuple[int, int, int]]()
        while self._end + _ENTRY.size <= size:
            name, seconds, count, checksum = _ENTRY.unpack(_read(file, self._end, _ENTRY.size))
            start = self._end + _ENTRY.size
            if not count or start + 8 * count > size:  # where the power was lost lie zeros
                break
            found[name] = start, count, checksum
            self._end, self.seconds = start + 8 * count, seconds
        return found

    def _stop(self, why: str) -> None:
        """Keep nothing more; what is kept can still be read."""
        self._full = True
        self._report(f"{why}: what is simulated from here on would be simulated again after a stop")


def _read(file: FileIO, start: int, size: int) -> bytes:
    """So many bytes from a place on, or all there are."""
    file.seek(start)
    parts = list[bytes]()
    while size and (part := file.read(size)):
        parts.append(part)
        size -= len(part)
    return b"".join(parts)


@cache
def _head() -> bytes:
    """What a file begins with."""
    digest, package = blake2b(" ".join(map(version, _PACKAGES)).encode(), digest_size=16), Path(__file__).parents[1]
    for place in (package / name for name in PREDICTS):
        for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
            digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return b"nfpde 1\n" + digest.digest()
