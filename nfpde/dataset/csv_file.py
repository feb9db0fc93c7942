"""Data sets as .csv, with the metadata in a file NAME.meta.json beside it."""

import csv
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv

from nfpde.dataset.dataset import Dataset
from nfpde.dataset.metadata import Metadata
from nfpde.dataset.naming import naming
from nfpde.dataset.recording import Recording
from nfpde.dataset.tables import TableLayout, read_header, recording_of_table, table_of_dataset
from nfpde.errors import BadDataset
from nfpde.storage import write_whole


def read_csv(path: Path, *, velocities: bool = True) -> Recording:
    """Read a .csv file in UTF-8, cells separated by commas, one header line.

    Args:
        path: The file. `NAME.meta.json` beside it is read where it exists.
        velocities: Whether they are read; if not, `qvel` has no columns.

    Returns:
        Its content, time steps not yet checked.

    Raises:
        BadDataset: The file cannot be read, a cell is no number, or a column breaks a rule.
    """
    header = _header(path)
    layout = read_header(header, velocities=velocities)
    try:
        types = {label: pa.float64() for label in layout.numbers} | {label: pa.string() for label in layout.texts}
        table = _read(path, header, types)
    except pa.ArrowInvalid as error:
        _refuse_cells(path, header, layout)
        raise BadDataset(f"the file cannot be read as a table ({str(error).splitlines()[0]}).") from None
    return recording_of_table(table, layout, _sidecar_metadata(metadata_path(path)))


def write_csv(dataset: Dataset, path: Path) -> None:
    """Write a data set as .csv; each number as the shortest text that reads back as the same float64.

    Args:
        dataset: The data set.
        path: File to write; the metadata is not written here (see `write_metadata`).
    """
    table = table_of_dataset(dataset)
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(table.column_names)
    with path.open("ab") as file:
        pacsv.write_csv(table, file, pacsv.WriteOptions(include_header=False))


def metadata_path(path: Path) -> Path:
    """Where the metadata of the .csv at `path` lies: NAME.meta.json beside NAME.csv."""
    return path.with_suffix(".meta.json")


def _header(path: Path) -> list[str]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header = next(csv.reader(file), [])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadDataset(f"the file cannot be read as UTF-8 text ({error}).") from None
    if not header:
        raise BadDataset("the file has no header line; the first line must name the columns.")
    return [label.strip() for label in header]


def _read(path: Path, header: list[str], types: dict[str, pa.DataType]) -> pa.Table:
    return pacsv.read_csv(
        path,
        read_options=pacsv.ReadOptions(column_names=header, skip_rows=1),
        convert_options=pacsv.ConvertOptions(
            column_types=types, include_columns=list(types), null_values=[""], strings_can_be_null=False
        ),
    )


def _refuse_cells(path: Path, header: list[str], layout: TableLayout) -> None:
    """Find the first cell that is no number, and say where it is."""
    try:
        table = _read(path, header, dict.fromkeys(layout.numbers, pa.string()))
    except pa.ArrowInvalid:
        return
    for label in layout.numbers:
        for row, text in enumerate(table.column(label).to_pylist()):
            try:
                float(text or "nan")
            except ValueError:
                raise BadDataset(
                    f"row {row}, column {label}: {text!r} is no number (rows are counted from 0 below the header). "
                    "Write numbers with a decimal point, without units."
                ) from None


def _sidecar_metadata(path: Path) -> Metadata:
    if not path.exists():
        return Metadata()
    with naming(path):
        try:
            return Metadata.from_json(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise BadDataset(f"the metadata cannot be read ({error}).") from None


def write_metadata(dataset: Dataset, path: Path) -> None:
    """Write the metadata of a .csv, whole or not at all.

    Args:
        dataset: The data set.
        path: Where the metadata goes (see `metadata_path`).
    """
    write_whole(path, dataset.metadata.to_json() + "\n")
