"""How loud the noise of the sensors is in each window: what its residuals are counted in.

Where contacts open and close, the same noise at a window's start makes a large error in one window and none in the
next. Counted alike, the loud windows drown what the quiet ones say.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import polygamma

from nfpde.dataset import Windows
from nfpde.gap.replay import Replay, started_beside

Array = NDArray[np.float64]

DRAWS = 12
"""Draws of the noise for every window."""


def noise_residuals(
    replay: Replay, xi: Array, windows: Windows, horizons: Sequence[int], sigma: Array, seed: int, draws: int = 1
) -> Array:
    """Residuals that sensor noise alone gives, some draws for every window (draws, N, nv, C).

    Noise at a window's start spreads as the simulation carries it on; noise at its end adds to that.
    """
    model, nv = replay.sim.model, replay.nv
    rng = np.random.default_rng(seed)
    steps = np.array(horizons) - 1
    a = replay.predict(xi[None], windows)[0][:, steps]
    found = []
    for _ in range(draws):
        moved = started_beside(model, windows, rng.normal(size=(len(windows), 2 * nv)) * sigma)
        apart = replay.sim.states.difference(replay.predict(xi[None], moved)[0][:, steps], a)
        found.append(replay.by_dof(apart + sigma * rng.normal(size=apart.shape)))
    return np.array(found)


def loudness(noise: Array, floor: Array) -> Array:
    """How loud windows are, relative to each other (N, nv, C), from draws of their noise (draws, N, nv, C).

    The logarithms of the variances are drawn together by as much as so few draws scatter: what is left where all
    windows are alike is one. Noise below the smallest residual believed, `floor` (nv, C), counts as that.
    """
    squares = np.where(np.isfinite(noise), noise, np.nan) ** 2
    with np.errstate(invalid="ignore"):
        variance = np.nanmean(squares, axis=0) if len(squares) else np.zeros(noise.shape[1:])
    variance = np.where(np.isfinite(variance), variance, np.nanmax(variance, initial=0.0)) + floor**2
    logs = np.log(np.maximum(variance, 1e-300))
    middle = logs.mean(0)
    scatter = np.maximum(logs.var(0), 1e-300)
    # a sum of as many squares of a Gaussian has a logarithm that varies by this
    kept = np.clip(1.0 - float(polygamma(1, len(noise) / 2)) / scatter, 0.0, 1.0)
    relative = np.exp(kept * (logs - middle))
    return np.sqrt(relative / relative.mean(0))
