"""The .npz format: one array a field, every episode below the other."""

import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from nfpde.dataset.columns import GROUPS, ColumnNames
from nfpde.dataset.dataset import Dataset
from nfpde.dataset.metadata import Metadata
from nfpde.dataset.recording import WITHOUT_VELOCITIES, Recording, check_extra
from nfpde.dataset.rows import episodes_of_rows, label_texts, rows_of_episodes
from nfpde.errors import BadDataset

_DAMAGED = (  # what zipfile, zlib and NumPy raise on bytes that are no archive of theirs
    OSError,
    EOFError,
    ValueError,
    KeyError,
    RuntimeError,
    SyntaxError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
)
_NAMES = tuple(f"{group}_names" for group in GROUPS)


def read_npz(path: Path, *, velocities: bool = True) -> Recording:
    """Read a .npz file; nothing in it is ever unpickled.

    Args:
        path: File with arrays `episode` (R,), `time` (R,), `qpos` (R, nq), `qvel` (R, nv), `ctrl` (R, nu) and,
            where known, `robot` (R,), `metadata` (JSON text), `qpos_names`, `qvel_names`, `ctrl_names`.
        velocities: Whether they are read; if not, `qvel` has no columns.

    Returns:
        Its content, time steps not yet checked.

    Raises:
        BadDataset: The file cannot be read, or its arrays break a rule.
    """
    arrays = _read_arrays(path)
    groups = GROUPS if velocities else tuple(group for group in GROUPS if group != "qvel")
    needed = ("episode", "time", *groups)
    missing = [name for name in needed if name not in arrays]
    if missing:
        found = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "none"
        raise BadDataset(
            f"missing array(s) {', '.join(missing)}; arrays found: {found}. Needed are episode (R,), time (R,) [s], "
            "qpos (R, nq), qvel (R, nv) and ctrl (R, nu); for a passive system save ctrl with shape (R, 0)."
            + (WITHOUT_VELOCITIES if missing == ["qvel"] else "")
        )
    extra = [name for name in arrays if name not in (*needed, *_NAMES, "robot", "metadata")]
    check_extra(extra, groups)
    rows = {name: arrays[name] for name in (*needed, "robot") if name in arrays}
    rows.setdefault("qvel", np.zeros((np.size(rows["episode"]), 0)))
    names = {
        group: label_texts(arrays[f"{group}_names"], f"{group}_names").tolist()
        for group in groups
        if f"{group}_names" in arrays
    }
    return Recording(
        episodes=episodes_of_rows(**rows),
        metadata=Metadata.from_json(_text(arrays["metadata"])) if "metadata" in arrays else Metadata(),
        column_names=ColumnNames(**names),
        extra_columns=tuple(extra),
    )


def npz_bytes(dataset: Dataset) -> bytes:
    """A data set as .npz (see `read_npz`), numbers unchanged bit by bit.

    Args:
        dataset: The data set.

    Returns:
        The file's content.
    """
    arrays: dict[str, Any] = rows_of_episodes(dataset.episodes)
    for group in GROUPS:
        if getattr(dataset.column_names, group) is not None:
            arrays[f"{group}_names"] = np.array(getattr(dataset.column_names, group), dtype=str)
    arrays["metadata"] = np.array(dataset.metadata.to_json())
    file = BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        archive = np.load(path, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise BadDataset("the file holds a single array; a .npz archive of named arrays is needed (numpy.savez).")
        with archive:
            arrays = {}
            for name in archive.files:
                try:
                    arrays[name] = archive[name]
                except ValueError as error:
                    raise BadDataset(
                        f"array {name} cannot be read ({error}). Arrays of Python objects would have to be unpickled, "
                        "which could run code: save it as numbers or text."
                    ) from None
            return arrays
    except _DAMAGED as error:
        raise BadDataset(f"the file cannot be read as .npz ({error}); write it with numpy.savez.") from None


def _text(array: np.ndarray) -> str:
    if array.dtype.kind != "U" or array.ndim != 0:
        raise BadDataset(
            f"the array metadata has type {array.dtype} and shape {array.shape}; it must be one JSON text."
        )
    return str(array)
