"""Folders of .npy files as DROPO and similar tools keep them: transitions of observations, not states."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset.arrays import frozen_floats
from nfpde.dataset.dataset import Dataset
from nfpde.dataset.episode import Episode
from nfpde.dataset.metadata import Metadata
from nfpde.dataset.naming import naming
from nfpde.dataset.resample import check_seconds
from nfpde.errors import BadDataset, BadInput

Columns = Sequence[int | np.integer[Any] | None] | NDArray[np.integer[Any]]
"""Columns of observations, by number; None for one that is not observed."""

_FILES = {"observations": 2, "nextobservations": 2, "actions": 2, "terminals": 1}


def load_dropo(
    folder: str | Path,
    *,
    qpos: Columns,
    qvel: Columns,
    control_dt: float,
    chained: bool = True,
    velocity_limit: float | None = 10.0,
) -> Dataset:
    """Load `*_observations.npy`, `*_nextobservations.npy`, `*_actions.npy` and `*_terminals.npy` of a folder.

    Observations do not say which of their columns are positions and velocities, so that is given here. The
    next observation of an episode's last transition becomes the episode's last row.

    Args:
        folder: The folder; one file of each kind.
        qpos: For each position of the model the observation's column; None where the observation leaves it
            out and 0 is right for it (the distance travelled, which does not enter the dynamics).
        qvel: The same for each velocity.
        control_dt: Time between an observation and the next [s]: frame skip times timestep.
        chained: Whether each next observation is the following row's observation, as recorded in sequence.
            With False each transition becomes an episode of its own.
        velocity_limit: Gymnasium's Hopper and Walker2d observe velocities clipped to +-10; a velocity at this
            limit is refused, because its true value is lost. None for no limit.

    Returns:
        The data set, with episodes "0", "1", ...

    Raises:
        BadDataset: A file is missing or breaks a rule, the rows do not follow each other, velocities are clipped.
        BadInput: The layout does not fit the observations.

    Example:
        Gymnasium's Hopper observes everything but the distance travelled: 5 positions, then 6 velocities:
        `load_dropo(folder, qpos=[None, 0, 1, 2, 3, 4], qvel=[5, 6, 7, 8, 9, 10], control_dt=0.008)`.
    """
    folder = Path(folder)
    check_seconds(control_dt, "control_dt")
    with naming(folder):
        arrays = _read_arrays(folder)
        columns = _columns(qpos, qvel, arrays["observations"].shape[1])
        before, after = _states(arrays["observations"], columns), _states(arrays["nextobservations"], columns)
        ends = _ends(arrays["terminals"]) if chained else np.arange(len(before))
        if chained:
            _check_chain(before, after, ends)
        if velocity_limit is not None:
            _check_limit(before[:, len(qpos) :], after[:, len(qpos) :], qvel, velocity_limit)
        episodes, first = [], 0
        for i, end in enumerate(ends.tolist()):
            state = np.vstack([before[first : end + 1], after[end]])
            action = arrays["actions"][first : end + 1]
            episodes.append(
                Episode(
                    name=str(i),
                    time=control_dt * np.arange(len(state)),
                    qpos=state[:, : len(qpos)],
                    qvel=state[:, len(qpos) :],
                    ctrl=np.vstack([action, action[-1]]),
                )
            )
            first = end + 1
        return Dataset(episodes, metadata=Metadata(control_dt=control_dt), source=str(folder))


def _read_arrays(folder: Path) -> dict[str, NDArray[np.float64]]:
    if not folder.is_dir():
        raise BadDataset("the folder does not exist.")
    arrays: dict[str, NDArray[np.float64]] = {}
    for kind, ndim in _FILES.items():
        files = sorted(f for f in folder.glob("*.npy") if f.stem == kind or f.stem.endswith(f"_{kind}"))
        if len(files) != 1:
            found = ", ".join(f.name for f in sorted(folder.iterdir())) or "nothing"
            raise BadDataset(f"{len(files)} files are named *_{kind}.npy; one is needed. The folder holds {found}.")
        array = _load(files[0])
        if kind == "terminals" and array.ndim == 2 and array.shape[1] == 1:
            array = array[:, 0]
        arrays[kind] = frozen_floats(array, files[0].name, ndim)
    lengths = {kind: len(array) for kind, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        raise BadDataset(f"the files differ in rows ({lengths}); each holds one row for a transition.")
    if not len(arrays["terminals"]):
        raise BadDataset("the files hold no transition; at least one is needed.")
    if arrays["observations"].shape != arrays["nextobservations"].shape:
        raise BadDataset(
            f"observations have {arrays['observations'].shape[1]} columns and next observations "
            f"{arrays['nextobservations'].shape[1]}; they must have the same."
        )
    return arrays


def _load(file: Path) -> NDArray[Any]:
    try:
        return np.load(file, allow_pickle=False)
    except (OSError, EOFError, ValueError) as error:
        raise BadDataset(
            f"{file.name} cannot be read ({error}). Arrays of Python objects would have to be unpickled, which could "
            "run code: save the file with numpy.save as an array of numbers."
        ) from None


def _columns(qpos: Columns, qvel: Columns, n: int) -> list[int | None]:
    columns = [*qpos, *qvel]
    given = [column for column in columns if column is not None]
    wrong = [
        column
        for column in given
        if isinstance(column, bool) or not isinstance(column, int | np.integer) or not 0 <= column < n
    ]
    if wrong:
        raise BadInput(
            f"the layout names column {wrong[0]!r}; observations have columns 0 to {n - 1} (or None, for 0)."
        )
    twice = sorted({column for column in given if given.count(column) > 1})
    if twice:
        raise BadInput(f"the layout takes column {twice[0]} twice; each column is one position or one velocity.")
    return [None if column is None else int(column) for column in columns]


def _states(observations: NDArray[np.float64], columns: list[int | None]) -> NDArray[np.float64]:
    states = np.zeros((len(observations), len(columns)))
    filled = [i for i, column in enumerate(columns) if column is not None]
    states[:, filled] = observations[:, [column for column in columns if column is not None]]
    return states


def _ends(terminals: NDArray[np.float64]) -> NDArray[np.int64]:
    wrong = ~np.isin(terminals, (0.0, 1.0))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise BadDataset(f"terminals, row {row}: {terminals[row]} is neither 0 nor 1 (False nor True).")
    return np.union1d(np.flatnonzero(terminals), [len(terminals) - 1])


def _check_chain(before: NDArray[np.float64], after: NDArray[np.float64], ends: NDArray[np.int64]) -> None:
    inside = np.setdiff1d(np.arange(len(before)), ends)
    broken = inside[(after[inside] != before[inside + 1]).any(axis=1)]
    if len(broken):
        raise BadDataset(
            f"row {broken[0]}: its next observation is not the observation of row {broken[0] + 1}, although no episode "
            f"ends there ({len(broken)} such row(s)). Mark the ends in terminals, or pass chained=False to take each "
            "transition as an episode of its own."
        )


def _check_limit(before: NDArray[np.float64], after: NDArray[np.float64], qvel: Columns, limit: float) -> None:
    clipped = (np.abs(before) == limit) | (np.abs(after) == limit)
    if clipped.any():
        row, column = np.argwhere(clipped)[0]
        raise BadDataset(
            f"row {row}, observation column {qvel[column]}: a velocity of exactly +-{limit:g} "
            f"({clipped.any(axis=1).sum()} such row(s)): the observation was clipped, the true velocity is "
            "lost. Record data.qvel instead of observations; or pass velocity_limit=None if these values are true."
        )
