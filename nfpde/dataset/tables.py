"""Tables of one column a number: from the header to the columns of a data set, and back."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from nfpde.dataset.arrays import frozen_floats
from nfpde.dataset.columns import GROUPS, ColumnNames, repeated
from nfpde.dataset.dataset import Dataset
from nfpde.dataset.metadata import Metadata
from nfpde.dataset.recording import WITHOUT_VELOCITIES, Recording, check_extra
from nfpde.dataset.rows import episodes_of_rows, rows_of_episodes
from nfpde.errors import BadDataset


@dataclass(frozen=True)
class TableLayout:
    """Which columns of a table mean what.

    Attributes:
        labels: For each group the table's column labels, in the order of the data set's columns.
        column_names: Element names, where the columns are not numbered.
        robot: Whether there is a column `robot`.
        extra: Labels of the columns that are not read.
    """

    labels: dict[str, list[str]]
    column_names: ColumnNames
    robot: bool
    extra: tuple[str, ...]

    @property
    def numbers(self) -> list[str]:
        """Labels of every column that must hold numbers."""
        return ["time", *(label for group in GROUPS for label in self.labels[group])]

    @property
    def texts(self) -> list[str]:
        """Labels of the columns that hold labels."""
        return ["episode", "robot"] if self.robot else ["episode"]


def read_header(header: Sequence[str], *, velocities: bool = True) -> TableLayout:
    """Understand a table's header.

    Args:
        header: Column labels: episode, time, qpos_0.., qvel_0.., ctrl_0.. (or qpos_ELEMENT and so on) in any
            order, optionally robot. Other columns are not read, unless they begin with qpos, qvel or ctrl.
        velocities: Whether they are read.

    Returns:
        The layout. Numbered columns are in the order of their numbers, named ones in the order of the table.

    Raises:
        BadDataset: Columns are missing, repeated, misnumbered or misnamed.
    """
    twice = repeated(header)
    if twice:
        raise BadDataset(f"column(s) {', '.join(twice)} stand more than once in the header; rename or remove them.")
    groups = GROUPS if velocities else tuple(group for group in GROUPS if group != "qvel")
    labels = {group: [label for label in header if label.startswith(f"{group}_")] for group in groups}
    missing = [label for label in ("episode", "time") if label not in header]
    states = [group for group in groups if group != "ctrl" and not labels[group]]
    missing += [f"{group}_0 (or {group}_ELEMENT)" for group in states]
    used = {"episode", "time", "robot", *(label for group in groups for label in labels[group])}
    extra = tuple(label for label in header if label not in used)
    check_extra(extra, groups)
    if missing:
        raise BadDataset(
            f"missing column(s) {', '.join(missing)}; columns found: {', '.join(header)}. Needed are episode (the same "
            "label in every row of one recording), time [s], qpos_0.., qvel_0.. and, unless passive, ctrl_0.., "
            "separated by commas." + (WITHOUT_VELOCITIES if len(missing) == 1 and states == ["qvel"] else "")
        )
    labels.setdefault("qvel", [])
    names: dict[str, tuple[str, ...] | None] = {}
    for group in groups:
        labels[group], names[group] = _order(group, labels[group])
    return TableLayout(labels, ColumnNames(**names), "robot" in header, extra)


def recording_of_table(table: pa.Table, layout: TableLayout, metadata: Metadata) -> Recording:
    """Make episodes of an Arrow table.

    Args:
        table: The table; integers and floats of any width.
        layout: What its columns mean.
        metadata: What is known of its origin.

    Returns:
        The content, time steps not yet checked.
    """
    rows: dict[str, Any] = {label: _labels(table, label) for label in layout.texts}
    rows["time"] = _numbers(table, "time")
    for group in GROUPS:
        columns = [_numbers(table, label) for label in layout.labels[group]]
        rows[group] = np.column_stack(columns) if columns else np.zeros((table.num_rows, 0))
    return Recording(episodes_of_rows(**rows), metadata, layout.column_names, layout.extra)


def table_of_dataset(dataset: Dataset) -> pa.Table:
    """The table that holds a data set.

    Args:
        dataset: The data set.

    Returns:
        Columns episode, robot (where known), time, qpos_*, qvel_*, ctrl_*.
    """
    rows = rows_of_episodes(dataset.episodes)
    columns: dict[str, Any] = {label: rows[label] for label in ("episode", "robot", "time") if label in rows}
    for group in GROUPS:
        labels = dataset.column_names.labels(group, rows[group].shape[1])
        columns |= dict(zip(labels, np.ascontiguousarray(rows[group].T), strict=True))
    return pa.table(columns)


def _order(group: str, labels: list[str]) -> tuple[list[str], tuple[str, ...] | None]:
    parts = [label.removeprefix(f"{group}_") for label in labels]
    numbered = [part for part in parts if part.isdecimal()]
    if not numbered:
        return labels, tuple(parts) or None
    if len(numbered) < len(parts):
        named = [label for label, part in zip(labels, parts, strict=True) if not part.isdecimal()]
        raise BadDataset(
            f"the {group} columns mix numbers and names ({group}_{numbered[0]}, {named[0]}); number all or name all."
        )
    expected = [f"{group}_{i}" for i in range(len(labels))]
    lacking = [label for label in expected if label not in labels]
    if lacking:
        raise BadDataset(
            f"the {group} columns are {', '.join(labels)}, so {', '.join(lacking)} is missing; {len(labels)} columns "
            f"are numbered from {group}_0 to {group}_{len(labels) - 1}, without gaps or leading zeros."
        )
    return expected, None


def _numbers(table: pa.Table, label: str) -> NDArray[np.float64]:
    column = table.column(label)
    if pa.types.is_decimal(column.type):
        column = column.cast(pa.float64())
    numeric = pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or pa.types.is_boolean(column.type)
    if not numeric and not pa.types.is_null(column.type):
        raise BadDataset(
            f"column {label} holds {column.type}; it must hold numbers (time in seconds). Convert it first."
        )
    _refuse_empty(column, label)
    return frozen_floats(column.to_numpy(), f"column {label}", 1)


def _labels(table: pa.Table, label: str) -> NDArray[Any]:
    column = table.column(label)
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if label == "robot":
        column = column.cast(pa.string()).fill_null("")
    _refuse_empty(column, label)
    values = column.to_numpy(zero_copy_only=False) if pa.types.is_primitive(column.type) else column.to_pylist()
    return np.array(values, dtype=None if len(values) else str)


def _refuse_empty(column: pa.ChunkedArray, label: str) -> None:
    if column.null_count:
        row = int(np.argmax(np.array(column.is_null())))
        raise BadDataset(
            f"row {row}, column {label}: the cell is empty ({column.null_count} empty cell(s) in the column); every "
            "cell needs a value. Fill it in, or remove the row."
        )
