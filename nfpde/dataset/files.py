"""Load and save data sets, in the format that the file's suffix names."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from nfpde.dataset.columns import ColumnNames
from nfpde.dataset.csv_file import metadata_path, read_csv, write_csv, write_metadata
from nfpde.dataset.dataset import Dataset
from nfpde.dataset.episode import Episode
from nfpde.dataset.folder import read_folder
from nfpde.dataset.naming import naming
from nfpde.dataset.npz import read_npz, write_npz
from nfpde.dataset.parquet_file import read_parquet, write_parquet
from nfpde.dataset.recording import Recording
from nfpde.dataset.resample import bridged_step, check_seconds, resample_episode, split_episode_at_gaps, whole_steps
from nfpde.errors import BadDataset, BadInput

_READERS: dict[str, Callable[[Path], Recording]] = {".npz": read_npz, ".csv": read_csv, ".parquet": read_parquet}
_WRITERS: dict[str, Callable[[Dataset, Path], None]] = {".npz": write_npz, ".csv": write_csv, ".parquet": write_parquet}


def load_dataset(
    path: str | Path,
    *,
    resample: float | None = None,
    quaternions: Sequence[int] = (),
    max_gap: float | None = None,
    split_gaps: bool = False,
) -> Dataset:
    """Load recordings from a file, or from every data file of a folder.

    Every rule of the format is checked. Recordings of real robots often have uneven steps in time, which are
    refused unless `resample` evens them out.

    Args:
        path: `.npz`, `.csv` or `.parquet`, or a folder of files of one of these formats.
        resample: Control step to resample every episode to [s]; None takes the rows as they are. See
            `resample_episode`.
        quaternions: First qpos column of each unit quaternion; only together with `resample`.
        max_gap: Longest step in time that is no gap [s], together with `resample` or `split_gaps`; None means 5
            median steps where `resample` is given (they are bridged), else 1.5.
        split_gaps: Whether to cut an episode into pieces at its gaps, instead of refusing it. The pieces are
            named NAME/0, NAME/1, ...; those too short for one control step are left out.

    Returns:
        The data set.

    Raises:
        BadDataset: The file cannot be read or breaks a rule; the text names file, episode, row, column, the
            rule and what to do.
        BadInput: An argument does not make sense.
    """
    if resample is None and quaternions:
        raise BadInput("quaternions is given without resample, where it would do nothing; give resample, or neither.")
    if resample is None and not split_gaps and max_gap is not None:
        raise BadInput("max_gap is given without resample or split_gaps, where it would do nothing; give one of them.")
    path = Path(path)
    with naming(path):
        recording = _read(path)
        episodes, metadata = list(recording.episodes), recording.metadata
        if resample is not None:
            episodes = [
                new for e in episodes for new in _resample(e, resample, quaternions, max_gap, split_gaps=split_gaps)
            ]
            metadata = replace(metadata, control_dt=float(resample))
        elif split_gaps:
            episodes = [piece for e in episodes for piece in split_episode_at_gaps(e, max_gap)]
        return Dataset(
            episodes,
            metadata=metadata,
            column_names=recording.column_names,
            extra_columns=recording.extra_columns,
            source=str(path),
        )


def read_column_names(path: str | Path) -> ColumnNames:
    """Names of the columns of a file, or of a folder's files, even where the steps in time are uneven.

    Raises:
        BadDataset: see `load_dataset`.
    """
    path = Path(path)
    with naming(path):
        return _read(path).column_names


def save_dataset(dataset: Dataset, path: str | Path) -> None:
    """Save a data set; loading it again gives the same numbers bit by bit, and the same metadata.

    The file appears whole or not at all. A `.csv` is joined by NAME.meta.json, which holds the metadata.

    Args:
        dataset: The data set.
        path: File to write or replace: `.npz`, `.csv` or `.parquet`.

    Raises:
        BadDataset: The suffix is unknown, the folder does not exist, or a table would have no velocities.
    """
    path = Path(path)
    with naming(path):
        write = _WRITERS[_known_suffix(path)]
        if not path.parent.is_dir():
            raise BadDataset("the folder to save in does not exist; create it first.")
        if dataset.nv == 0 and path.suffix.lower() != ".npz":
            raise BadDataset("a table needs velocity columns, and these recordings have none; save them as .npz.")
    temporary = path.with_name(f".{path.name}.part")
    try:
        write(dataset, temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    if path.suffix.lower() == ".csv":
        write_metadata(dataset, metadata_path(path))


def _read(path: Path) -> Recording:
    if path.is_dir():
        return read_folder(path, _READERS)
    read = _READERS[_known_suffix(path)]
    if not path.exists():
        raise BadDataset("the file does not exist.")
    return read(path)


def _resample(
    episode: Episode, control_dt: float, quaternions: Sequence[int], max_gap: float | None, *, split_gaps: bool
) -> list[Episode]:
    max_gap = bridged_step(episode) if max_gap is None else max_gap
    pieces = [episode]
    if split_gaps:
        check_seconds(control_dt, "resample")
        cut = split_episode_at_gaps(episode, max_gap)
        pieces = [piece for piece in cut if piece is episode or whole_steps(piece, control_dt)]
        if not pieces:
            longest = max(piece.duration for piece in cut)
            raise BadDataset(
                f"episode {episode.name!r}: cut at its gaps (steps longer than max_gap={max_gap:.6g} s), its longest "
                f"piece lasts {longest:.6g} s, less than one control step of {control_dt:.6g} s; resample to a smaller "
                "step, raise max_gap, or remove the episode."
            )
    return [resample_episode(piece, control_dt, quaternions=quaternions, max_gap=max_gap) for piece in pieces]


def _known_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise BadDataset(f"unknown suffix {path.suffix!r}; known are {', '.join(_READERS)}.")
    return suffix
