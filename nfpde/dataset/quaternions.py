"""Which columns of recordings are unit quaternions."""

from collections.abc import Sequence

import numpy as np

from nfpde.dataset.episode import Episode
from nfpde.errors import BadDataset, BadInput


def check_columns(quaternions: Sequence[int], nq: int) -> None:
    """Refuse quaternions that overlap, or lie beyond the columns.

    Args:
        quaternions: First qpos column of each.
        nq: Number of columns.

    Raises:
        BadInput: Which ones.
    """
    taken: set[int] = set()
    for first in quaternions:
        columns = set(range(first, first + 4))
        if first < 0 or first + 4 > nq or taken & columns:
            raise BadInput(
                f"quaternions={list(quaternions)}: each takes 4 qpos columns from its first on, inside "
                f"nq={nq} and without overlap."
            )
        taken |= columns


def check_lengths(episode: Episode, columns: slice) -> None:
    """Refuse a quaternion of length zero in these columns.

    Raises:
        BadDataset: In which row.
    """
    norms = np.linalg.norm(episode.qpos[:, columns], axis=1)
    if (norms == 0).any():
        row = int(np.argmin(norms))
        raise BadDataset(
            f"episode {episode.name!r}, row {row}, column qpos_{columns.start}: the quaternion is zero; "
            "it must have unit length."
        )
