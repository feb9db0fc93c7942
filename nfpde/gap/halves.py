"""Which recordings are held out: whole episodes, and one in part where it alone shows what there is to see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset, Windows

Array = NDArray[np.float64]

FEWEST = 20
"""Windows below which nothing is said."""

LEAST_HALF = 0.3
"""Share of the windows that either half has at least where halves are chosen to be alike."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What is held out.

    episodes: their indices
    shared: an episode that is held out in part; None: there is none
    row: windows of the shared episode that end after this row are held out
    swapped: whether it is all others that are held out
    """

    episodes: NDArray[np.intp]
    shared: int | None = None
    row: int = 0
    swapped: bool = False

    def late(self, windows: Windows) -> NDArray[np.bool_]:
        """Of every window, whether it is held out (N,)."""
        ends_late = windows.row + windows.horizon > self.row
        late = np.isin(windows.episode, self.episodes) | ((windows.episode == self.shared) & ends_late)
        return late != self.swapped

    def names(self, dataset: Dataset) -> tuple[str, ...]:
        """Names of the episodes, and from or up to which row a shared one is held out."""
        mine = [i for i in range(len(dataset)) if (i in self.episodes) != self.swapped and i != self.shared]
        side = "up to" if self.swapped else "from"
        part = () if self.shared is None else (f"{dataset.names[self.shared]} {side} row {self.row}",)
        return (*(dataset.names[i] for i in mine), *part)


def by_seed(lengths: NDArray[np.intp], steps: int, seed: int) -> HeldOut:
    """Episodes with about half of the windows; the second half of one where the others are too short for that.

    Args:
        lengths: Rows of the episodes.
        steps: Control steps of a window.
        seed: Of the draw.
    """
    usable = np.flatnonzero(lengths > steps)
    if len(usable) < 2:
        longest = int(lengths.argmax())
        return HeldOut(usable[:0], longest, (int(lengths[longest]) - 1) // 2)
    order = np.random.default_rng(seed).permutation(usable)
    total = np.cumsum(lengths[order] // steps)
    count = int(np.clip(np.searchsorted(total, total[-1] / 2) + 1, 1, len(order) - 1))
    fewest = min(int(total[count - 1]), int(total[-1] - total[count - 1]))
    longest = int(lengths.argmax())
    if fewest < FEWEST and fewest < int(lengths[longest]) // steps // 2:
        return HeldOut(usable[:0], longest, (int(lengths[longest]) - 1) // 2)
    return HeldOut(np.sort(order[:count]))


def alike_halves(every: Windows, gap: Array, seed: int, longest: Windows) -> HeldOut | None:
    """What to hold out so that both halves show as much of the gap; None where there is too little to choose from.

    An effect may show in few episodes only, and must be seen in both halves: in the one that finds it, and in the
    other that confirms it. Episodes are paired by their gap, and the seed decides which of a pair is held out. One that
    shows more than all others together is shared: cut in time where the lesser part shows most. Where episodes are so
    unlike in length that a half would be left with few windows, nothing is chosen.

    Args:
        every: Windows of all episodes.
        gap: Of each of them (N,).
        seed: Of the draw.
        longest: The same recordings in the longest windows, of which either half needs some.
    """
    episodes = np.unique(every.episode)
    if len(episodes) < 3:
        return None
    total, mean = (np.array([f(gap[every.episode == e]) for e in episodes]) for f in (np.sum, np.mean))
    loudest = int(total.argmax())
    shared, row = None, 0
    if total[loudest] > total.sum() - total[loudest]:
        shared, mean = int(episodes[loudest]), np.delete(mean, loudest)
        episodes, row = episodes[episodes != shared], _cut(every, gap, shared)
    elif len(episodes) < 4:
        return None
    order = episodes[np.argsort(-mean, kind="stable")]
    rng = np.random.default_rng(seed)
    pairs = order[: len(order) // 2 * 2].reshape(-1, 2)
    held = HeldOut(np.sort([pair[rng.integers(2)] for pair in pairs]), shared, row)
    for windows, fewest in ((every, LEAST_HALF * len(every)), (longest, FEWEST)):
        late = int(held.late(windows).sum())
        if min(late, len(windows) - late) < max(FEWEST, fewest):
            return None
    return held


def _cut(windows: Windows, gap: Array, episode: int) -> int:
    """The row of an episode where a window ends and its gaps before and after it have the largest lesser sum."""
    mine = np.flatnonzero(windows.episode == episode)
    mine = mine[np.argsort(windows.row[mine], kind="stable")]
    before = np.cumsum(gap[mine])
    at = int(np.minimum(before, before[-1] - before).argmax())
    return int(windows.row[mine[at]]) + windows.horizon
