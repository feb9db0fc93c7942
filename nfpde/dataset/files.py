"""Load and save data sets, in the format that the file's suffix names."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from nfpde.dataset.columns import ColumnNames
from nfpde.dataset.csv_file import csv_bytes, metadata_path, read_csv, write_metadata
from nfpde.dataset.dataset import Dataset
from nfpde.dataset.episode import Episode
from nfpde.dataset.folder import read_folder
from nfpde.dataset.naming import naming
from nfpde.dataset.npz import npz_bytes, read_npz
from nfpde.dataset.parquet_file import parquet_bytes, read_parquet
from nfpde.dataset.recording import Recording
from nfpde.dataset.resample import bridged_step, check_seconds, resample_episode, split_episode_at_gaps, whole_steps
from nfpde.dataset.velocities import COMPUTED, differentiate_episode, names_with_velocities
from nfpde.errors import BadDataset, BadInput
from nfpde.storage import write_whole

_READERS: dict[str, Callable[..., Recording]] = {".npz": read_npz, ".csv": read_csv, ".parquet": read_parquet}
_CONTENTS: dict[str, Callable[[Dataset], bytes]] = {".npz": npz_bytes, ".csv": csv_bytes, ".parquet": parquet_bytes}


def load_dataset(
    path: str | Path,
    *,
    resample: float | None = None,
    quaternions: Sequence[int] = (),
    max_gap: float | None = None,
    split_gaps: bool = False,
    differentiate: bool = False,
) -> Dataset:
    """Load recordings from a file, or from every data file of a folder.

    Every rule of the format is checked. Recordings of real robots often have uneven steps in time, which are
    refused unless `resample` evens them out.

    Args:
        path: `.npz`, `.csv` or `.parquet`, or a folder of files of one of these formats.
        resample: Control step to resample every episode to [s]; None takes the rows as they are. See
            `resample_episode`.
        quaternions: First qpos column of each unit quaternion; only together with `resample` or `differentiate`.
        max_gap: Longest step in time that is no gap [s], together with `resample` or `split_gaps`; None means 5
            median steps where `resample` is given (they are bridged), else 1.5.
        split_gaps: Whether to cut an episode into pieces at its gaps, instead of refusing it. The pieces are
            named NAME/0, NAME/1, ...; those too short for one control step are left out.
        differentiate: Whether to take the velocities from the positions, for recordings that have none; those of the
            file are not read then. See `differentiate_episode`.

    Returns:
        The data set.

    Raises:
        BadDataset: The file cannot be read or breaks a rule; the text names file, episode, row, column, the
            rule and what to do.
        BadInput: An argument does not make sense.
    """
    if quaternions and resample is None and not differentiate:
        raise BadInput(
            "quaternions is given without resample or differentiate, where it would do nothing; give one of these, or "
            "none of the three."
        )
    if resample is None and not split_gaps and max_gap is not None:
        raise BadInput("max_gap is given without resample or split_gaps, where it would do nothing; give one of them.")
    path = Path(path)
    with naming(path):
        recording = _read(path, velocities=not differentiate)
        metadata, names = recording.metadata, recording.column_names
        if resample is not None:
            check_seconds(resample, "resample")
            metadata = replace(metadata, control_dt=float(resample))
        if differentiate:
            metadata = replace(metadata, conventions={**metadata.conventions, **COMPUTED})
        episodes = []
        for episode in recording.episodes:
            longest = bridged_step(episode) if max_gap is None and resample is not None else max_gap
            pieces = _pieces(episode, longest, resample) if split_gaps else [episode]
            if differentiate:  # before resampling, which loses rows
                pieces = [differentiate_episode(piece, quaternions) for piece in pieces]
            if resample is not None:
                pieces = [resample_episode(p, resample, quaternions=quaternions, max_gap=longest) for p in pieces]
            episodes += pieces
        return Dataset(
            episodes,
            metadata=metadata,
            column_names=names_with_velocities(names, quaternions) if differentiate else names,
            extra_columns=recording.extra_columns,
            source=str(path),
        )


def read_column_names(path: str | Path, *, velocities: bool = True) -> ColumnNames:
    """Names of the columns of a file, or of a folder's files, even where the steps in time are uneven.

    Args:
        path: See `load_dataset`.
        velocities: Whether there must be velocities.

    Raises:
        BadDataset: see `load_dataset`.
    """
    path = Path(path)
    with naming(path):
        return _read(path, velocities=velocities).column_names


def save_dataset(dataset: Dataset, path: str | Path) -> None:
    """Save a data set; loading it again gives the same numbers bit by bit, and the same metadata.

    The file appears whole or not at all, whatever stops the process and whoever else writes it. A `.csv` is joined by
    NAME.meta.json, which holds the metadata and is written first.

    Args:
        dataset: The data set.
        path: File to write or replace: `.npz`, `.csv` or `.parquet`.

    Raises:
        BadDataset: The suffix is unknown, the folder does not exist, or a table would have no velocities.
        OSError: The file cannot be written (a full disk, a folder that is read-only); `filename` is its name.
    """
    path = Path(path)
    with naming(path):
        content_of = _CONTENTS[_known_suffix(path)]
        if not path.parent.is_dir():
            raise BadDataset("the folder to save in does not exist; create it first.")
        if dataset.nv == 0 and path.suffix.lower() != ".npz":
            raise BadDataset("a table needs velocity columns, and these recordings have none; save them as .npz.")
    content = content_of(dataset)
    if path.suffix.lower() == ".csv":
        write_metadata(dataset, metadata_path(path))  # rows without their metadata would load as if they had none
    write_whole(path, content)


def _read(path: Path, *, velocities: bool) -> Recording:
    if path.is_dir():
        return read_folder(path, {suffix: partial(read, velocities=velocities) for suffix, read in _READERS.items()})
    if not path.exists():
        what = "file" if path.suffix.lower() in _READERS else "file or folder"
        raise BadDataset(f"the {what} does not exist; give the path of recordings: {', '.join(_READERS)}, or a folder.")
    read = _READERS[_known_suffix(path)]
    return read(path, velocities=velocities)


def _pieces(episode: Episode, max_gap: float | None, control_dt: float | None) -> list[Episode]:
    """An episode cut at its gaps; those pieces that last a control step, where it is known."""
    cut = split_episode_at_gaps(episode, max_gap)
    if control_dt is None or cut == [episode]:
        return cut
    pieces = [piece for piece in cut if whole_steps(piece, control_dt)]
    if not pieces:
        longest = max(piece.duration for piece in cut)
        raise BadDataset(
            f"episode {episode.name!r}: cut at its gaps (steps longer than max_gap={max_gap:.6g} s), its longest "
            f"piece lasts {longest:.6g} s, less than one control step of {control_dt:.6g} s; resample to a smaller "
            "step, raise max_gap, or remove the episode."
        )
    return pieces


def _known_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise BadDataset(f"unknown suffix {path.suffix!r}; known are {', '.join(_READERS)}.")
    return suffix
