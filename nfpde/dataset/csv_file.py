"""Data sets as .csv, with the metadata in a file NAME.meta.json beside it."""

import csv
from io import BytesIO, StringIO
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
        _refuse_lengths(path, len(header))
        _refuse_cells(path, header, layout)
        raise BadDataset(f"the file cannot be read as a table ({str(error).splitlines()[0]}).") from None
    return recording_of_table(table, layout, _sidecar_metadata(metadata_path(path)))


def csv_bytes(dataset: Dataset) -> bytes:
    """A data set as .csv; each number as the shortest text that reads back as the same float64.

    Args:
        dataset: The data set.

    Returns:
        The file's content, without the metadata (see `write_metadata`).
    """
    table = table_of_dataset(dataset)
    header, rows = StringIO(), BytesIO()
    csv.writer(header, lineterminator="\n").writerow(table.column_names)
    pacsv.write_csv(table, rows, pacsv.WriteOptions(include_header=False))
    return header.getvalue().encode() + rows.getvalue()


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


def _refuse_lengths(path: Path, n: int) -> None:
    """Find the first row that has another number of cells than the header, and say where it is."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = (row for row in csv.reader(file) if row)  # empty lines are no rows
        next(rows, None)
        try:
            found = next(((i, len(row)) for i, row in enumerate(rows) if len(row) != n), None)
        except (UnicodeDecodeError, csv.Error):
            return
    if found is not None:
        raise BadDataset(
            f"row {found[0]} has {found[1]} cells and the header {n} (rows are counted from 0 below the header); every "
            "row has one cell a column. Complete or remove it; a decimal comma or a comma in a text reads as two cells."
        )


def _refuse_cells(path: Path, header: list[str], layout: TableLayout) -> None:
    """Find the first cell that is no number, and say where it is."""
    try:
        table = _read(path, header, dict.fromkeys(layout.numbers, pa.string()))
    except pa.ArrowInvalid:
        return
    for label in layout.numbers:
        for row, text in enumerate(table.column(label).to_pylist()):
            if not _is_number(text or "nan"):
                raise BadDataset(
                    f"row {row}, column {label}: {text!r} is no number (rows are counted from 0 below the header). "
                    "Write numbers with a decimal point, without units and without marks between the digits."
                )


def _is_number(text: str) -> bool:
    """Whether Arrow reads a cell as a number: Python's float also takes 1_000 and the digits of other scripts."""
    try:
        pa.scalar(text.strip()).cast(pa.float64())
    except pa.ArrowInvalid:
        return False
    return True


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
