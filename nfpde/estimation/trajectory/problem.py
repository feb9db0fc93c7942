"""The residuals of whole robots: every recording of one robot is explained by one parameter vector."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.dataset import Dataset, Windows
from nfpde.dataset.velocities import computed_velocities
from nfpde.errors import BadDataset, BadInput
from nfpde.losses import increment_scale
from nfpde.sim import Simulator, Whitening

Array = NDArray[np.float64]
Index = NDArray[np.intp]


PRECISION = 1e-9
"""Smallest believable residual, in units of what a channel changes by: rounding errors of a simulation are larger."""

NUMBERS_AT_ONCE = 1 << 23
"""Numbers in the residuals that one call of the simulator returns, about (64 MiB)."""

MATRICES = 13
"""Matrices of C x C doubles for every window that learning the noise holds at a time, at least (measured)."""

COLUMNS = 4
"""Columns of C doubles for every window and parameter that it holds beside them: slopes, and what solves for them."""


@dataclass(frozen=True, eq=False)
class Problem:
    """N windows, robot after robot, and their residuals in units of how much each channel changes over a window.

    names: label of every robot                                          (G,)
    episodes: names of every robot's episodes                            G tuples
    members: indices of each robot's windows                             G arrays
    unit: what a residual of 1 stands for in each channel                (C,)
    floor: residual below which no channel is believed, in units         (C,)
    grain: error of a measured state below which no channel is believed, in units    (ndiff,)
    computed: which channels of a state are velocities that were computed from positions    (ndiff,)
    """

    simulator: Simulator
    windows: Windows
    names: tuple[str, ...]
    episodes: tuple[tuple[str, ...], ...]
    members: tuple[Index, ...]
    unit: Array
    floor: Array
    grain: Array
    computed: NDArray[np.bool_]

    @property
    def channels(self) -> int:
        """Numbers in a window's residual, C = H x ndiff."""
        return len(self.unit)

    @property
    def velocities(self) -> NDArray[np.bool_]:
        """Which channels of a state are velocities, (ndiff,)."""
        states = self.simulator.states
        return np.arange(states.ndiff) >= states.ndiff - states.nv

    @property
    def coarse(self) -> bool:
        """Whether the simulator rounds too much for differences over the shortest steps, as single precision does."""
        return self.simulator.rounding > 1e-12

    @property
    def linked(self) -> NDArray[np.bool_]:
        """Whether a window starts from the state at which the one before it ends, (N,)."""
        w = self.windows
        return np.append(False, (np.diff(w.episode) == 0) & (np.diff(w.row) == w.horizon))

    def residuals(self, xi: Array, robot: Sequence[int] | Index) -> list[Array]:
        """Predicted minus measured, scaled: vectors (K, D), vector k on all windows of robot[k], to K arrays (n_k, C).

        A window whose simulation diverged holds NaN.
        """
        counts = np.array([len(self.members[g]) for g in robot])
        vector = np.repeat(np.arange(len(xi)), counts)
        window = np.concatenate([self.members[g] for g in robot])
        rows = self.simulator.residuals(xi, self.windows, vector, window, self.unit)
        return np.split(rows, np.cumsum(counts)[:-1])

    def costs(self, xi: Array, robot: Index, whitening: Whitening) -> Array:
        """Twice the negative log likelihood of vector k (K, D) on all windows of robot[k], up to a constant, (K,)."""
        vector = np.repeat(np.arange(len(xi)), [len(self.members[g]) for g in robot])
        window = np.concatenate([self.members[g] for g in robot])
        return self.simulator.costs(xi, self.windows, vector, window, self.unit, whitening)

    def started_from(self, errors: Array) -> Problem:
        """The same windows, started from their states less errors of these (N, ndiff) in units."""
        states, state = self.simulator.states, self.windows.state.copy()
        state[:, 0] = states.moved(state[:, 0], -errors * self.unit[: states.ndiff])
        return replace(self, windows=replace(self.windows, state=state))

    def grown_by(self, change: Array) -> Problem:
        """The same windows, their measured ends moved so that the residuals grow by `change` (N, C) in units."""
        states, state = self.simulator.states, self.windows.state.copy()
        step = -(change * self.unit).reshape(len(state), -1, states.ndiff)
        state[:, 1:] = states.moved(state[:, 1:], step)
        return replace(self, windows=replace(self.windows, state=state))

    def in_parts(self, z: Array, robot: Index) -> Iterator[list[Array]]:
        """`residuals` of unconstrained vectors z (K, D), a part at a time.

        Memory for simulations is bounded so; what grows with the windows is in `check_memory`.
        """
        for part in self.parts(robot):
            yield self.residuals(self.simulator.space.to_physical(z[part]), robot[part])

    def parts(self, robot: Index, copies: int = 1) -> list[slice]:
        """Cut K vectors, each simulated `copies` times on all windows of its robot, where memory asks for it."""
        numbers = np.array([len(m) for m in self.members])[robot] * (self.channels * copies)
        ends = np.flatnonzero(np.diff(np.cumsum(numbers) // NUMBERS_AT_ONCE)) + 1
        edges = [0, *ends.tolist(), len(robot)]
        return [slice(a, b) for a, b in pairwise(edges) if b > a]

    def check_memory(self) -> None:
        """Refuse recordings of which the covariances of all windows do not fit into this machine's memory.

        Raises:
            BadDataset: with the numbers, and what makes fewer of them.
        """
        numbers = MATRICES * self.channels**2 + COLUMNS * self.channels * len(self.simulator.space)
        needed, there = 8 * numbers * len(self.windows), memory()
        if there is not None and needed > there:
            raise BadDataset(
                f"{len(self.windows)} windows of {self.channels} numbers each need about {needed / 2**30:.3g} GiB and "
                f"the machine has {there / 2**30:.3g}: take fewer or shorter recordings, resample them to a lower "
                "rate, or shorten the horizon (the memory grows with it)"
            )


def memory() -> int | None:
    """Bytes of memory of this machine; None where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def make_problem(simulator: Simulator, dataset: Dataset, horizon: int, resolution: ArrayLike | None = None) -> Problem:
    """Cut a data set into windows that do not overlap and sort them by robot (by episode where robots have no label).

    Args:
        simulator: predicts.
        dataset: recordings that fit it.
        horizon: control steps in a window.
        resolution: smallest step that the sensors show, one number or one per channel (ndiff,), in the recorded units.

    Raises:
        BadDataset: a robot whose episodes are all shorter than the horizon.
        BadInput: a resolution that is negative, not finite or of another shape.
    """
    dt = dataset.control_dt
    windows = dataset.windows(horizon, history=simulator.history_steps(dt), past=simulator.past_steps(dt))
    labels = [e.robot if e.robot is not None else f"episode {e.name}" for e in dataset]
    names = tuple(dict.fromkeys(labels))
    owner = np.array([names.index(label) for label in labels])[windows.episode]
    order = np.argsort(owner, kind="stable")
    windows, owner = windows[order], owner[order]
    members = tuple(np.flatnonzero(owner == g) for g in range(len(names)))
    short = [name for name, m in zip(names, members, strict=True) if not len(m)]
    if short:
        raise BadDataset(f"{short[0]} has no window of {horizon} control steps; shorten the horizon or leave it out")
    unit = np.tile(increment_scale(simulator.states, windows), horizon)
    floor = np.full(len(unit), PRECISION)
    grain = np.zeros(simulator.states.ndiff)
    if resolution is not None:
        # rounding to steps of r leaves errors that are uniform over a step: a standard deviation of r / sqrt(12)
        grain = _steps(simulator, resolution) / np.sqrt(12.0) / unit[: len(grain)]
    episodes = tuple(tuple(e.name for e, o in zip(dataset, labels, strict=True) if o == name) for name in names)
    computed = computed_channels(simulator, dataset)
    return Problem(simulator, windows, names, episodes, members, unit, floor, grain, computed)


def computed_channels(simulator: Simulator, dataset: Dataset) -> NDArray[np.bool_]:
    """Which channels of a state are velocities that were computed from positions, (ndiff,)."""
    states = simulator.states
    computed = np.zeros(states.ndiff, bool)
    computed[states.ndiff - states.nv + computed_velocities(dataset, states.axes)] = True
    return computed


def _steps(simulator: Simulator, resolution: ArrayLike) -> Array:
    channels = simulator.states.channels
    try:
        steps = np.asarray(resolution, dtype=np.float64)
    except (TypeError, ValueError):
        steps = np.array(np.nan)
    if steps.shape not in ((), (len(channels),)) or not (np.isfinite(steps) & (steps >= 0)).all():
        raise BadInput(
            f"resolution must be one number, or one for each of the {len(channels)} channels ({', '.join(channels)}), "
            f"none negative; got {resolution!r:.200}"
        )
    return np.broadcast_to(steps, (len(channels),))
