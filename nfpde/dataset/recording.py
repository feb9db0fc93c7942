"""What a reader hands over, before even time steps are asked for."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from nfpde.dataset.columns import GROUPS, ColumnNames
from nfpde.dataset.episode import Episode
from nfpde.dataset.metadata import Metadata
from nfpde.errors import BadDataset

WITHOUT_VELOCITIES = (
    " Recordings without velocities can have them taken from their positions: load_dataset(..., differentiate=True), "
    "on the command line --differentiate."
)


@dataclass(frozen=True)
class Recording:
    """Content of one file.

    Attributes:
        episodes: Its episodes; their steps in time may be uneven.
        metadata: What the file says of its origin.
        column_names: Element names of the columns.
        extra_columns: What was not read.
    """

    episodes: Sequence[Episode]
    metadata: Metadata
    column_names: ColumnNames
    extra_columns: tuple[str, ...]


def check_extra(extra: Iterable[str], groups: tuple[str, ...] = GROUPS) -> None:
    """Refuse unknown columns that look like ones a reader should have understood.

    Args:
        extra: Columns or arrays that were not read.
        groups: What is read.

    Raises:
        BadDataset: One begins with the name of a group.
    """
    close = [name for name in extra if name.startswith(groups)]
    if close:
        raise BadDataset(
            f"unknown column(s) or array(s) {', '.join(close)}: a name that begins with qpos, qvel or ctrl must be "
            "one of the format (in tables qpos_0 or qpos_ELEMENT, in .npz qpos and qpos_names). Rename it."
        )
