"""Load and save data sets, by the file's suffix."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from nfpde.dataset.dataset import Dataset
from nfpde.dataset.naming import naming
from nfpde.dataset.npz import read_npz, write_npz
from nfpde.dataset.recording import Recording
from nfpde.dataset.resample import resample_episode, split_episode_at_gaps
from nfpde.errors import BadDataset

_READERS: dict[str, Callable[[Path], Recording]] = {".npz": read_npz}
_WRITERS: dict[str, Callable[[Dataset, Path], None]] = {".npz": write_npz}


def load_dataset(
    path: str | Path,
    *,
    resample: float | None = None,
    quaternions: Sequence[int] = (),
    max_gap: float | None = None,
    split_gaps: bool = False,
) -> Dataset:
    """Load recordings from a file."""
    path = Path(path)
    with naming(path):
        recording = _READERS[_known_suffix(path)](path)
        episodes = list(recording.episodes)
        if split_gaps:
            episodes = [piece for e in episodes for piece in split_episode_at_gaps(e, max_gap)]
        if resample is not None:
            episodes = [resample_episode(e, resample, quaternions=quaternions, max_gap=max_gap) for e in episodes]
        return Dataset(
            episodes,
            metadata=recording.metadata,
            column_names=recording.column_names,
            extra_columns=recording.extra_columns,
            source=str(path),
        )


def save_dataset(dataset: Dataset, path: str | Path) -> None:
    """Save a data set, in the format that the suffix names."""
    path = Path(path)
    with naming(path):
        write = _WRITERS[_known_suffix(path)]
    temporary = path.with_name(f".{path.name}.part")
    write(dataset, temporary)
    os.replace(temporary, path)


def _known_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise BadDataset(f"unknown suffix {path.suffix!r}; known are {', '.join(_READERS)}.")
    return suffix
