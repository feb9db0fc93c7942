"""The transitions of a training on the disk: one file a round, so that a checkpoint writes only what is new."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from nfpde.errors import BadInput
from nfpde.storage import write_whole

ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class ReplayFiles:
    """Files `<first>-<end>.npz` with the transitions first to end - 1, counted from the training's start.

    Each file holds `observations` (n, 1, nobs), `next_observations`, `actions` (n, 1, nu), `rewards` (n, 1), `dones`
    and `timeouts`. The buffer is a ring: transition i lies at i modulo its size.

    Args:
        folder: where the files are.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def add(self, buffer: Any, first: int, end: int) -> None:
        """Write the transitions first to end - 1; to be called before the state that counts them is saved."""
        first = max(first, end - buffer.buffer_size)
        rows = np.arange(first, end) % buffer.buffer_size
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self._path(first, end)
        data = io.BytesIO()
        np.savez(data, allow_pickle=False, **{name: getattr(buffer, name)[rows] for name in ARRAYS})
        write_whole(path, data.getvalue())

    def clean(self, size: int, end: int) -> None:
        """Delete files that a buffer of `size` with `end` transitions in all has no use for."""
        for path, first, last in self._files():
            if last <= end - size or first >= end:
                path.unlink()
        for leftover in self.folder.glob("*.tmp"):
            leftover.unlink()

    def load(self, buffer: Any, ends: Sequence[int]) -> None:
        """Fill a buffer as it was after rounds with so many transitions; files of other rounds are left alone.

        Args:
            buffer: to be filled.
            ends: transitions before the first round, none, and after each.

        Raises:
            BadInput: a file is missing or damaged.
        """
        size, end = buffer.buffer_size, ends[-1]
        have = max(0, end - size)
        for begin, last in pairwise(ends):
            if last <= have:
                continue
            first = max(begin, last - size)
            path = self._path(first, last)
            if not path.exists():
                raise BadInput(
                    f"{self.folder}: transitions {have} to {end} are missing. Delete the training's folder to start "
                    "afresh."
                )
            try:
                with np.load(path, allow_pickle=False) as file:
                    rows = np.arange(first, last) % size
                    for name in ARRAYS:
                        getattr(buffer, name)[rows] = file[name]
            except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
                raise BadInput(
                    f"{path} is damaged ({error}). Delete the folder to start the training afresh."
                ) from None
            have = last
        buffer.pos, buffer.full = end % size, end >= size

    def _path(self, first: int, end: int) -> Path:
        return self.folder / f"{first:012d}-{end:012d}.npz"

    def _files(self) -> list[tuple[Path, int, int]]:
        found = []
        for path in sorted(self.folder.glob("*-*.npz")):
            first, _, last = path.stem.partition("-")
            found.append((path, int(first), int(last)))
        return found
