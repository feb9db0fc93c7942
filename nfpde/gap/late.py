"""Speeds that run behind their positions, as filtered ones do.

A filter of the speeds alone makes them late, by a few milliseconds in most drives: whoever starts a simulation with
them starts it wrong, and no effect explains what follows. A speed that was measured is as often ahead of the change of
its position from the row before to the one after as it is behind, up to what commands do that change in that very row;
that much the nominal model does, too. A fault of one joint changes it there. A filter filters them all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from nfpde.dataset import Dataset
from nfpde.dataset.velocities import differentiated
from nfpde.elements import listed
from nfpde.gap.differences import Differences
from nfpde.gap.levels import FLOOR_ERROR
from nfpde.gap.readings import axes_of
from nfpde.gap.replay import Replay

Array = NDArray[np.float64]
Columns = NDArray[np.intp]

MOST = 3000
"""Rows that are looked at."""

PARTS = 30
"""Stretches of rows, each left out in turn, as neighbours resemble each other (jackknife: Efron and Stein, Annals of
Statistics, 1981)."""

CHANCE = 1e-3
"""Probability of calling any one speed late where none is, shared by the axes; more than half of them are needed."""

TWICE = 2.0
"""Times as late as the nominal model's at least: a fault may well make that half as much again."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of recordings, A axes side by side.

    ahead: how far the mean speed of the steps before and after a row is ahead of its own (N, A)
    change: how the speed changes there (N, A)
    """

    ahead: Array
    change: Array

    @classmethod
    def of(cls, states: tuple[Array, Array, Array], q: Columns, v: Columns, control_dt: float) -> _Rows:
        """From the states before, in, and after each row (N, nx); the columns of positions and speeds."""
        before, here, after = states
        mean = (after[:, q] - before[:, q]) / (2 * control_dt)
        return cls(mean - here[:, v], (after[:, v] - before[:, v]) / (2 * control_dt))

    def lag(self) -> Array:
        """By how much speeds run behind [s] (A,), by least squares."""
        return _slope(self._sums().sum(1))

    def lags_without(self) -> Array:
        """The same without each part of the rows in turn (PARTS, A)."""
        sums = self._sums()
        return _slope(sums.sum(1)[:, None] - sums)

    def _sums(self) -> Array:
        edges = np.linspace(0, len(self.ahead), PARTS + 1).astype(np.intp)[:-1]
        return np.stack([np.add.reduceat(x, edges) for x in (self.ahead * self.change, self.change**2)])


def believed(replay: Replay, dataset: Dataset, xi: Array) -> tuple[Dataset, Differences]:
    """Recordings with velocities taken from the positions where theirs are late, and which nobody measured, or not so.

    Args:
        replay: The nominal model.
        dataset: Recordings in its order.
        xi: Its free parameters (D,).
    """
    computed = Differences.of(replay.sim.model, dataset)
    late = "" if computed.said else late_speeds(replay, dataset, xi)
    if not late:
        return dataset, computed
    dataset = differentiated(dataset, [q for q, _ in replay.sim.states.quaternions])
    return dataset, replace(Differences.of(replay.sim.model, dataset), late=late)


def late_speeds(replay: Replay, dataset: Dataset, xi: Array) -> str:
    """By how much most speeds run behind their positions, and which, in words; "" where they do not.

    Args:
        replay: The nominal model.
        dataset: Recordings in its order.
        xi: Its free parameters (D,).
    """
    model, dt = replay.sim.model, dataset.control_dt
    axes = axes_of(model)
    if not axes or max(len(e) for e in dataset) < 3:
        return ""
    back, past = replay.sim.history_steps(dt), replay.sim.past_steps(dt)
    total = len(dataset.windows(2, stride=1))
    some = np.unique(np.linspace(0, total - 1, min(MOST, total)).round().astype(np.intp))
    windows = dataset.windows(2, stride=1, history=back, past=past, at=some)
    q, v = np.array([(axis.q, model.nq + axis.v) for axis in axes]).T
    simulated = replay.predict(xi[None], windows)[0]
    sound = np.isfinite(simulated).all((1, 2))
    if sound.sum() < 2 * PARTS:
        return ""
    measured, simulated = windows.state[sound], simulated[sound]
    seen = _Rows.of((measured[:, 0], measured[:, 1], measured[:, 2]), q, v, dt)
    usual = _Rows.of((measured[:, 0], simulated[:, 0], simulated[:, 1]), q, v, dt)
    late = _late(seen, usual, 0.5 * model.opt.timestep)
    if 2 * late.sum() <= len(axes):
        return ""
    low, high = (f"{1e3 * lag:.2g}" for lag in (seen.lag()[late].min(), seen.lag()[late].max()))
    names = listed([axis.name for axis, is_late in zip(axes, late, strict=True) if is_late])
    return f"{low if low == high else f'{low} to {high}'} ms at {names}"


def _late(seen: _Rows, usual: _Rows, least: float) -> NDArray[np.bool_]:
    """Whether speeds are surely later than the model's by more than `least` [s], and it is not lost in noise (A,).

    MuJoCo moves positions by the speeds at the end of a step, which are late by half of it; a robot's steps, or another
    simulation's, may be finer.
    """
    lag, model = seen.lag(), usual.lag()
    beyond, each = lag - model, seen.lags_without() - usual.lags_without()
    error = np.sqrt((PARTS - 1) / PARTS * ((each - each.mean(0)) ** 2).sum(0))
    sure = beyond - least > student.isf(CHANCE / len(lag), PARTS - 1) * error
    makes, left = (beyond * seen.change) ** 2, (seen.ahead - lag * seen.change) ** 2
    return sure & (lag > TWICE * np.abs(model)) & (makes.mean(0) > FLOOR_ERROR * left.mean(0))


def _slope(sums: Array) -> Array:
    return sums[0] / np.maximum(sums[1], 1e-300)
