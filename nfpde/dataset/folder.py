"""Recordings spread over several files of one folder."""

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

from nfpde.dataset.metadata import Metadata
from nfpde.dataset.naming import naming
from nfpde.dataset.recording import Recording
from nfpde.errors import BadDataset


def read_folder(folder: Path, readers: dict[str, Callable[[Path], Recording]]) -> Recording:
    """Read every data file of a folder, in the order of their names.

    An episode is named FILE/EPISODE, with the file's name without its suffix.

    Args:
        folder: The folder; all its data files must be of one format. Other files are left alone.
        readers: A reader for each suffix.

    Returns:
        The joined content, time steps not yet checked.

    Raises:
        BadDataset: No data file or two formats, columns that differ, or metadata that contradict each other.
    """
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in readers and file.name[0] != ".")
    suffixes = sorted({file.suffix.lower() for file in files})
    if not files and any(folder.glob("*observations.npy")):
        raise BadDataset(
            "the folder holds .npy files of observations, which do not say what their columns are. Call "
            "load_dropo(folder, qpos=[...], qvel=[...], control_dt=...) with the columns of qpos and qvel."
        )
    if len(suffixes) != 1:
        found = ", ".join(suffixes) or "none"
        raise BadDataset(f"the folder must hold data files of one format ({', '.join(readers)}); found: {found}.")
    parts = []
    for file in files:
        with naming(file):
            parts.append(readers[suffixes[0]](file))
    first = parts[0]
    metadata = first.metadata
    for file, part in zip(files[1:], parts[1:], strict=True):
        if part.column_names != first.column_names:
            raise BadDataset(
                f"{file.name} and {files[0].name} name their columns differently ({part.column_names} and "
                f"{first.column_names}); give every file the same columns in the same order."
            )
        metadata = _join(metadata, part.metadata, file.name)
    return Recording(
        episodes=[
            replace(e, name=f"{file.stem}/{e.name}")
            for file, part in zip(files, parts, strict=True)
            for e in part.episodes
        ],
        metadata=metadata,
        column_names=first.column_names,
        extra_columns=tuple(dict.fromkeys(label for part in parts for label in part.extra_columns)),
    )


def _join(metadata: Metadata, other: Metadata, file: str) -> Metadata:
    for field in fields(Metadata):
        mine, its = getattr(metadata, field.name), getattr(other, field.name)
        if field.name != "notes" and mine != its:
            raise BadDataset(
                f"{file}: the metadata's {field.name} is {its!r}, in the files before it {mine!r}; one data set has "
                "one. Load the files apart, or correct the metadata."
            )
    notes = dict.fromkeys(note for note in (*metadata.notes.split("\n"), *other.notes.split("\n")) if note)
    return replace(metadata, notes="\n".join(notes))
