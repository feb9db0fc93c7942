"""Recordings cut for a diagnosis: windows to fit, windows held out, and the horizons to compare at."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset, Windows
from nfpde.errors import BadDataset
from nfpde.gap.grain import Encoders
from nfpde.gap.halves import FEWEST, HeldOut, by_seed

Array = NDArray[np.float64]
Index = NDArray[np.intp]

WINDOW_TIME = 0.25
"""Longest window [s]: long enough for a weak force to move the robot, short enough for a prediction to hold."""

LEAST_WINDOWS = 240
"""Windows wanted, over fit and held-out episodes; short recordings are cut into shorter windows to get there."""

MOST_STEPS, LEAST_STEPS = 60, 4
"""Control steps of a window."""

MOST_WINDOWS = 160
"""Windows used of each half: more tell little that these do not."""

LEAST_USED = 80
"""Windows used of each half where the model has many degrees of freedom, each of which tells something."""

BLOCK = 5
"""Neighbouring windows whose gains are averaged before standard errors are taken: neighbours resemble each other. Of
windows that are shorter than the longest, those within the time of a longest one at least."""

LEAST_BLOCKS = 30
"""Blocks for which that time is cut, where recordings are short: with fewer, errors themselves are not known."""

LEAD = 0.5
"""Time [s] left out there at most, or 25 control steps, if they are longer: recordings are too short to spare more."""

MOST_LEFT_OUT = 0.2
"""Share of the windows that may be left out at the beginnings of episodes."""


_MEMORY = 1 << 24
"""Numbers that single steps and what came before them may take, if few of them would do: 1 kHz has long pasts."""


@dataclass(frozen=True, eq=False)
class Recordings:
    """Windows of the two halves of a data set.

    horizons: control steps after which predictions are compared, ascending; the last is the window's length
    block: of every held-out window, its group for standard errors (held,)
    held_out: names of the held-out episodes, see `HeldOut.names`
    rows: held-out single steps in a row, for the sensor noise
    longest: held-out windows as long as any, where these may be shorter
    encoders: what the readings in all rows tell of the encoders
    force: typical generalized forces (nv,) where contacts are, else None
    """

    fit: Windows
    held: Windows
    horizons: tuple[int, ...]
    block: NDArray[np.intp]
    held_out: tuple[str, ...]
    rows: Windows
    longest: Windows
    encoders: Encoders
    force: Array | None = None

    @property
    def positions_alone(self) -> bool:
        """Whether positions alone are compared, as velocities were computed from them, or some of them were."""
        return self.encoders.computed is not None

    @property
    def channels(self) -> int | None:
        """Channels of every degree of freedom that are compared, the first so many; None: all."""
        return len(self.horizons) if self.positions_alone else None


def joined(first: Windows, second: Windows) -> Windows:
    """The windows of both halves, one after the other."""
    names = ("state", "ctrl", "history", "past", "episode", "row")
    return replace(first, **{n: np.concatenate([getattr(first, n), getattr(second, n)]) for n in names})


def windows_for(nv: int) -> int:
    """Windows of each half for a model with nv degrees of freedom."""
    return int(np.clip(2000 // max(nv, 1), LEAST_USED, MOST_WINDOWS))


def cut_recordings(
    dataset: Dataset,
    history: int,
    seed: int,
    windows: int,
    lead: int = 0,
    held: HeldOut | None = None,
    past: int | None = None,
    computed: Array | None = None,
    *,
    swapped: bool = False,
) -> Recordings:
    """Split by episode (one episode: by time), and cut.

    Args:
        dataset: The recordings.
        history: Commands needed from before a window's start.
        seed: Decides which episodes are held out.
        windows: Most windows of each half.
        lead: Rows at an episode's beginning that an effect with a memory knows too little of: no window starts there,
            where enough others do.
        held: What to hold out; None: as the seed decides.
        past: States needed from before a window's start; None: as many as commands.
        computed: What velocities that nobody measured take of the positions, see `Differences.weights`.
        swapped: Whether what would be held out is fitted, and the rest held out.

    Raises:
        BadDataset: Too little data for `FEWEST` windows of each half.
    """
    lengths = np.array([len(e) for e in dataset])
    # at an episode's end a velocity is a difference to one side: it is that of half a step later
    first = 0 if computed is None or not computed.any() else 1
    steps = _window_steps(lengths - first, dataset.control_dt)
    held = by_seed(lengths, steps, seed) if held is None else held
    held = replace(held, swapped=swapped)
    past = history if past is None else past
    stride = steps + 1  # a row apart: the noise of one that ends a window and starts the next would be in both
    chosen = _halves(dataset.windows(steps, stride=stride, first=first), lead, held)
    if min(map(len, chosen)) < FEWEST:  # short recordings cannot spare the rows
        stride = steps
        chosen = _halves(dataset.windows(steps, first=first), lead, held)
    for half, name in zip(chosen, ("fit", "hold out"), strict=True):
        if len(half) < FEWEST:
            raise BadDataset(
                f"the recordings are too short for a diagnosis: {len(half)} windows of {steps} control steps to "
                f"{name}, at least {FEWEST} are needed; record about {2 * FEWEST * LEAST_STEPS} control steps or more, "
                f"best as four or more episodes"
            )
    fit, late = (
        dataset.windows(steps, stride=stride, history=history, past=past, at=_spread(half, windows), first=first)
        for half in chosen
    )
    singles = dataset.windows(1, first=first)
    inside = np.flatnonzero(np.isin(singles.episode, late.episode) & held.late(singles))
    width = history * dataset[0].ctrl.shape[1] + past * (dataset[0].qpos.shape[1] + dataset[0].qvel.shape[1])
    most = int(np.clip(_MEMORY // max(width, 1), 2 * windows, 20 * windows))
    rows = dataset.windows(1, history=history, past=past, at=inside[:most], first=first)
    encoders = Encoders.of([np.hstack([e.qpos, e.qvel]) for e in dataset], computed)
    return Recordings(fit, late, _horizons(steps), blocks_of(late), held.names(dataset), rows, late, encoders)


def _halves(every: Windows, lead: int, held: HeldOut) -> tuple[Index, Index]:
    """Indices of windows to fit and of held-out ones, without as much of the beginnings as they can spare."""
    spared = np.sort(every.row)[int(MOST_LEFT_OUT * len(every))] if len(every) else 0
    settled = every.row >= min(lead, spared)
    late = held.late(every)
    return np.flatnonzero(settled & ~late), np.flatnonzero(settled & late)


def _window_steps(lengths: NDArray[np.intp], control_dt: float) -> int:
    by_time = round(WINDOW_TIME / control_dt)
    by_data = int((lengths - 1).sum()) // LEAST_WINDOWS - 1
    steps = int(np.clip(min(by_time, by_data), LEAST_STEPS, MOST_STEPS))
    longest = int(lengths.max()) - 1
    return max(1, min(steps, longest // 2 if len(lengths) == 1 else longest))


def _horizons(steps: int) -> tuple[int, ...]:
    wanted = [1, round(steps / 8), round(steps / 4), round(steps / 2), steps]
    return tuple(sorted({int(np.clip(h, 1, steps)) for h in wanted}))


def _spread(windows: Index, most: int) -> Index:
    """At most `most` of some windows, evenly over all of them."""
    if len(windows) <= most:
        return windows
    return windows[np.unique(np.linspace(0, len(windows) - 1, most).round().astype(int))]


def blocks_of(windows: Windows) -> NDArray[np.intp]:
    """Groups of neighbouring windows of one episode."""
    block = np.empty(len(windows), dtype=np.intp)
    episodes = [np.flatnonzero(windows.episode == episode) for episode in np.unique(windows.episode)]
    rows = [int(np.ptp(windows.row[mine])) + windows.horizon for mine in episodes]
    long = max(1.0, min(WINDOW_TIME / windows.control_dt, sum(rows) / LEAST_BLOCKS))
    number = -1
    for mine, span in zip(episodes, rows, strict=True):
        parts = max(1, min(len(mine) // BLOCK, int(span / long)))
        for part in np.array_split(mine, parts):
            number += 1
            block[part] = number
    return block
