"""Names of a data set's columns, where the recording has them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from nfpde.dataset.episode import check_label
from nfpde.errors import BadDataset

GROUPS = ("qpos", "qvel", "ctrl")
"""The three groups of columns, in the order in which files hold them."""


@dataclass(frozen=True)
class ColumnNames:
    """Element names of the columns, in column order; None where a group is numbered.

    A joint of several columns (free, ball) has one name a column: `root[0]` ... `root[6]`.

    Attributes:
        qpos: Joint names of the position columns. Length nq.
        qvel: Joint names of the velocity columns. Length nv.
        ctrl: Actuator names of the command columns. Length nu.
    """

    qpos: tuple[str, ...] | None = None
    qvel: tuple[str, ...] | None = None
    ctrl: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        for group in GROUPS:
            names = getattr(self, group)
            if names is None:
                continue
            object.__setattr__(self, group, tuple(names))
            for name in names:
                check_label(name, f"a {group} column's name")
                if name.isdecimal():
                    raise BadDataset(
                        f"a {group} column is named {name!r}; a name of digits alone reads as a column number. "
                        "Use element names, or number every column of the group."
                    )
            twice = repeated(names)
            if twice:
                raise BadDataset(f"the {group} names hold {', '.join(twice)} more than once; names are unique.")

    def labels(self, group: str, n: int) -> list[str]:
        """File column labels of a group, such as `qpos_elbow` or `qpos_0`.

        Args:
            group: "qpos", "qvel" or "ctrl".
            n: Number of columns of the group.

        Returns:
            One label a column.
        """
        names: Sequence[str] | None = getattr(self, group)
        return [f"{group}_{name}" for name in (range(n) if names is None else names)]


def expand_names(names: Sequence[str], widths: Sequence[int]) -> list[str]:
    """Column names of elements that may take several columns each.

    Args:
        names: Element names, in the model's order.
        widths: Columns of each (7 or 4 in qpos, 6 or 3 in qvel for free and ball joints; else 1).

    Returns:
        The name itself for a width of 1, else `name[0]`, `name[1]`, ...

    Example:
        >>> expand_names(["ball", "elbow"], [3, 1])
        ['ball[0]', 'ball[1]', 'ball[2]', 'elbow']
    """
    return [
        name if width == 1 else f"{name}[{i}]" for name, width in zip(names, widths, strict=True) for i in range(width)
    ]


def repeated(labels: Iterable[str]) -> list[str]:
    """The labels that occur more than once, in order of their second occurrence."""
    seen: set[str] = set()
    twice: dict[str, None] = {}
    for label in labels:
        if label in seen:
            twice[label] = None
        seen.add(label)
    return list(twice)
