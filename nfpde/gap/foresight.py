"""Commands that act a row before they are written down: no robot foresees them, so they were written down too late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset, Windows
from nfpde.errors import BadDataset
from nfpde.gap.readings import CURED
from nfpde.gap.replay import Replay

Array = NDArray[np.float64]

_PAST = 1
"""Rows before whose commands tell, too: with them their trend. Noise of the sensors hides the state, and where
commands are smooth the next one would stand in for it."""

_MOST, _EACH, _FEWEST = 300, 20, 5
"""Steps that are looked at; for each of the numbers that predict them, where these are many; and for each the fewest
with which anything is said. Half of the steps are laid aside."""

_PARTS, _DRAWS, _SURE, _MOSTLY = 30, 1000, 0.995, 0.5
"""Parts in succession that rows are drawn in, draws (bootstrap: Efron, Tibshirani, An introduction to the bootstrap,
1993), the share of these that must agree, and on what: that less than so much is left. A sound log that is refused
helps nobody."""


def check_commands(replay: Replay, dataset: Dataset, xi: Array) -> None:
    """Refuse commands that are one row late.

    Whatever fault a robot has, the change of its speeds from a row to the next depends on its state and on commands up
    to that row. That change is predicted from them, to first order, beside the nominal model; then from the next row's
    command, which the model is given instead. Where that explains most of what was left, the next row's command had
    acted already. What a stiffer servo does, which leads the model as well, follows from state and command alone.
    One joint is not enough, as a body that rests on others is thrown about by small faults: the gains in log likelihood
    of all joints (normal errors, every joint's variance its own) must sum to as much, and none counts for more than
    that: a body at rest lacks next to nothing, of which next to nothing may explain any share.

    Args:
        replay: The nominal model.
        dataset: The recordings.
        xi: Its free parameters (D,).

    Raises:
        BadDataset: The commands look one row late.
    """
    if dataset.nu == 0 or max(len(e) for e in dataset) < 3:
        return
    sim = replay.sim
    back = max(_PAST, sim.history_steps(dataset.control_dt))
    known = 1 + dataset.nq + dataset.nv + (1 + _PAST) * dataset.nu
    chosen = _most_commanded(dataset.windows(2, stride=1), max(_MOST, _EACH * known))
    if len(chosen) < _FEWEST * known:
        return
    windows = dataset.windows(2, stride=1, history=back, past=sim.past_steps(dataset.control_dt), at=chosen)
    as_written = replace(windows, state=windows.state[:, :2], ctrl=windows.ctrl[:, :1])
    before = np.concatenate([windows.history, windows.ctrl[:, :1]], axis=1)
    shifted = replace(as_written, ctrl=windows.ctrl[:, 1:], history=before[:, 1:])
    now, then = (replay.predict(xi[None], w)[0][:, 0, windows.nq :] for w in (as_written, shifted))
    lacking, row = windows.state[:, 1, windows.nq :] - now, then - now
    sound = np.isfinite(lacking + row).all(1)
    if sound.sum() < _FEWEST * known:
        return
    past = windows.history[:, -_PAST:].reshape(len(windows), -1)
    told = np.hstack([np.ones((len(windows), 1)), windows.state[:, 0], windows.ctrl[:, 0], past])
    joints = [c for c in range(dataset.nv) if (row[sound, c] != 0).any()]
    squares = np.array([_squares(told[sound], lacking[sound, c], row[sound, c]) for c in joints])
    if len(joints) and _surely_late(squares):
        raise BadDataset(
            f"the commands look one row late: ctrl[r] must act from row r to row r+1, and here it is the command that "
            f"led to row r ({np.exp(_left(squares)[0].min()):.2g} of what the nominal model cannot explain is left "
            f"with the next row's commands). Shift them in every episode: ctrl[:-1] = ctrl[1:]"
        )


def _most_commanded(windows: Windows, most: int) -> NDArray[np.intp]:
    """Indices of the windows in which commands change most: there it shows in which row they acted."""
    change = np.abs(windows.ctrl[:, 1] - windows.ctrl[:, 0])
    size = (change / np.where(change.max(0) > 0, change.max(0), 1.0)).sum(1)
    chosen = np.argsort(-size, kind="stable")[:most]
    return np.sort(chosen[size[chosen] > 0])


def _surely_late(squares: Array) -> bool:
    """Whether a row's step explains most of what was left in all rows, and in nearly all draws of their parts.

    Where contacts throw a body about, a few rows make up all that is left, and chance decides about these.

    Args:
        squares: See `_squares`, of all joints (nv, n, 3).
    """
    if not _late(squares, CURED):
        return False
    rng, parts = np.random.default_rng(0), np.array_split(np.arange(squares.shape[1]), _PARTS)
    sums = np.stack([squares[:, part].sum(1) for part in parts], axis=1)
    late = [_late(sums[:, rng.integers(0, _PARTS, _PARTS)], _MOSTLY) for _ in range(_DRAWS)]
    return float(np.mean(late)) >= _SURE


def _late(squares: Array, share: float) -> bool:
    """Whether so little is left at one joint, and of all joints together, of which none counts for more than that."""
    least, of_residual = _left(squares)
    together = np.maximum(of_residual, np.log(share)).sum()
    return bool((least < np.log(share)).any() and together <= np.log(share))


def _left(squares: Array) -> tuple[Array, Array]:
    """Share of what state and command do not tell that is left when a row's step is taken, by joint, as logarithms.

    Of the residual, or of the row's step, whichever is smaller (nv,); and of the residual (nv,).
    """
    before, step, after = np.log(np.maximum(squares.sum(1), 1e-300)).T
    return after - np.minimum(before, step), after - before


def _squares(told: Array, lacking: Array, row: Array) -> Array:
    """What state and command (n, K) do not tell of the residual, the row's step and their difference, squared (n, 3).

    In the half of the rows that either explains best, else zero: contacts make of some what they like.
    """
    columns = np.column_stack([lacking, row, lacking - row])
    apart = np.abs(_untold(told, columns))
    nearest = np.minimum(apart[:, 0], apart[:, 2])
    half = nearest <= np.median(nearest)
    squares = np.zeros_like(columns)
    squares[half] = _untold(told[half], columns[half]) ** 2
    return squares


def _untold(told: Array, columns: Array) -> Array:
    return columns - told @ np.linalg.lstsq(told, columns, rcond=None)[0]
