"""How a simulator behaves: one control step from a few recorded states, which tells whether it is still the same.

Names tell functions apart, but not what they do: one that was edited, or given other numbers, would go on with the fit
of another simulator.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset
from nfpde.losses import increment_scale
from nfpde.parameters import ParameterSpace
from nfpde.sim import Simulator

Array = NDArray[np.float64]

Behaviour = list[list[float | None]]
"""Plain JSON values, see `observe`."""

STARTS = 8
"""Recorded states, spread over all recordings."""

POINTS = 3
"""Parameter vectors: the middle of the bounds, and two others."""

ROUNDING, ROUNDING_SINGLE = 1e-4, 1e-2
"""Differences that count as rounding, in what the recordings move in a control step, of simulators that say that they
compute in double precision (they may hold a network that does not) and in single precision. Another machine or number
of threads rounds otherwise, and in one step not much comes of it; longer predictions of contacts are chaotic."""

GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def observe(simulator: Simulator, dataset: Dataset) -> Behaviour:
    """Changes of the state that it predicts for one control step, by parameters, then start, as plain JSON values.

    Args:
        simulator: predicts.
        dataset: recordings that fit it.

    Returns:
        A row for each prediction, in what each channel of the recordings moves in a control step, root mean square;
        null where the simulation diverged.
    """
    dt = dataset.control_dt
    history, past = simulator.history_steps(dt), simulator.past_steps(dt)
    scale = increment_scale(simulator.states, dataset.windows(1, stride=1))
    total = sum(len(e) - 1 for e in dataset)
    at = np.unique(np.linspace(0, total - 1, min(total, STARTS)).astype(int))
    windows = dataset.windows(1, stride=1, history=history, past=past, at=at)
    xi = _points(simulator.space)
    vector, window = np.repeat(np.arange(POINTS), len(at)), np.tile(np.arange(len(at)), POINTS)
    ends = simulator.rollout(xi, windows, vector, window)
    moves = simulator.states.difference(ends, windows.start[window][:, None])[:, 0] / scale
    return [[float(f"{x:.10g}") if np.isfinite(x) else None for x in row] for row in moves.tolist()]


def difference(before: Behaviour, now: Behaviour, simulator: Simulator) -> tuple[str, str, str] | None:
    """The largest difference of two behaviours beyond rounding: what it is, and both its values; None for none.

    Args:
        before: what `observe` told of a simulator.
        now: what it tells of another, of the same recordings and parameters.
        simulator: the other.
    """
    first, second = (np.array(b, dtype=np.float64) for b in (before, now))
    if first.shape != second.shape:
        return "number of predictions", str(first.shape), str(second.shape)
    apart = np.abs(first - second) / np.maximum(1.0, np.abs(first))
    broken = np.isnan(first) != np.isnan(second)
    apart = np.where(broken, np.inf, np.nan_to_num(apart))
    row, channel = np.unravel_index(int(apart.argmax()), apart.shape)
    least = ROUNDING_SINGLE if simulator.rounding > 1e-12 else ROUNDING
    if apart[row, channel] <= least:
        return None
    count = int((apart > least).any(1).sum())
    name = simulator.states.channels[channel]
    what = (
        f"what {name} changes by in a control step, in {count} of {len(first)} test predictions (in what the "
        "recordings change by)"
    )
    return what, _shown(first[row, channel]), _shown(second[row, channel])


def _points(space: ParameterSpace) -> Array:
    """The middle of the bounds, and other places off it in every parameter by another share."""
    turns = np.arange(POINTS)[:, None] * np.arange(1, len(space) + 1) * GOLDEN
    return space.low + space.width * (0.1 + 0.8 * ((0.5 + turns) % 1.0))


def _shown(value: Any) -> str:
    return "diverged" if np.isnan(value) else f"{value:.8g}"
