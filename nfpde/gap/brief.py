"""Short windows, for robots whose contacts make long ones useless to fit: an error soon decides what touches what.

A fit over long windows has to cross as many jumps as there are contacts that open or close; over a single step next to
none (multiple shooting with the shortest intervals: Bock, 1983). What noise takes from a short window their number
gives back.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.recordings import Recordings, blocks_of

LENGTHS = 3
"""Lengths of short windows, shortest first: the shortest of the horizons at which long windows are compared."""

MOST, EVERY = 400, 3000
"""Windows of one control step in each half, at most; of h steps fewer by the root of h. So many find what is worth a
name in most recordings; those of a fault that noise nearly hides take all there are. With half as many a floor that is
wrong is taken for other things, too."""


def brief(recordings: Recordings, most: int = MOST) -> list[Recordings]:
    """The same recordings in short windows, shortest first; none where no horizon is shorter than the windows.

    Args:
        recordings: In the longest windows.
        most: Windows of one control step in each half.
    """
    found = []
    for length in range(_fewest(recordings), min(LENGTHS, len(recordings.horizons) - 1) + 1):
        horizons = recordings.horizons[:length]
        count = _most(most, horizons[-1])
        fit, held = (shorter(half, horizons[-1], count) for half in (recordings.fit, recordings.held))
        found.append(replace(recordings, fit=fit, held=held, horizons=horizons, block=blocks_of(held)))
    return found


def single_steps(recordings: Recordings, most: int = MOST) -> int:
    """How many windows the shortest of `brief` has, of both halves together; 0 where there are none."""
    length = _fewest(recordings)
    if len(recordings.horizons) <= length:
        return 0
    steps = recordings.horizons[length - 1]
    halves = (recordings.fit, recordings.held)
    return sum(min(_most(most, steps), len(half) * (half.horizon // steps)) for half in halves)


def _fewest(recordings: Recordings) -> int:
    """Horizons of the shortest windows.

    A single step from a velocity that nobody measured tells that velocity, and nothing else.
    """
    return 2 if recordings.positions_alone else 1


def _most(of_one_step: int, steps: int) -> int:
    return max(1, round(of_one_step / steps**0.5))


def shorter(windows: Windows, steps: int, most: int) -> Windows:
    """Windows of fewer steps, one after the other in each of the given ones, at most so many evenly over all."""
    count = windows.horizon // steps
    total = len(windows) * count
    which, part = np.divmod(np.unique(np.linspace(0, total - 1, min(most, total)).round().astype(int)), count)
    commands, known = np.concatenate([windows.history, windows.ctrl], axis=1), windows.nhistory
    states, before = np.concatenate([windows.past, windows.state], axis=1), windows.past.shape[1]

    def rows(of: NDArray[np.float64], length: int) -> NDArray[np.float64]:
        return of[which[:, None], (part * steps)[:, None] + np.arange(length)]

    return replace(
        windows,
        state=rows(windows.state, steps + 1),
        ctrl=rows(windows.ctrl, steps),
        history=rows(commands, known),
        past=rows(states, before),
        episode=windows.episode[which],
        row=windows.row[which] + part * steps,
    )
