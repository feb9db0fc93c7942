"""How loud the noise of the sensors is in each window: what its residuals are counted in.

Where contacts open and close, the same noise at a window's start makes a large error in one window and none in the
next. Counted alike, the loud windows drown what the quiet ones say.

Which windows are loud differs from one model to the next: what touches what hangs on a hair. In windows that are quiet
to one model alone every other is far off, and the noise of a wrong model makes it the likeliest of all, by hundreds of
nats in a hundred windows. Noise is asked for beside a few models, each pushed aside a little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import polygamma

from nfpde.dataset import Windows
from nfpde.gap.replay import Replay, started_beside

Array = NDArray[np.float64]

DRAWS = 12
"""Draws of the noise for every window."""

ASIDE, MODELS = 0.05, 6
"""Constant force by which a model is pushed aside, as a share of the typical one, and how many such models there are:
what a weak effect would do, of which nobody knows where it acts. Half of it and six times as much do the same."""

_PUSHES = 0
"""Seed of these."""


@dataclass(frozen=True, eq=False)
class Loudness:
    """Divides the residuals of each window by how loud noise is in it, channel by channel.

    size: (N, nv, C)
    """

    size: Array

    def quieten(self, residuals: Array) -> Array:
        """Residuals (..., N, nv, C) in units of their loudness."""
        return residuals / self.size

    def some(self, index: NDArray[np.intp] | slice) -> Loudness:
        """The same of some windows."""
        return Loudness(self.size[index])

    @property
    def log_volume(self) -> float:
        """Logarithm of what densities change by, summed over windows [nats]."""
        return float(-np.log(self.size).sum())


def noise_residuals(
    replay: Replay,
    xi: Array,
    windows: Windows,
    horizons: Sequence[int],
    sigma: Array,
    seed: int,
    draws: int = 1,
    force: Array | None = None,
) -> Array:
    """Residuals that sensor noise alone gives, some draws for every window (draws, N, nv, C).

    Noise at a window's start spreads as the simulation carries it on; noise at its end adds to that.

    Args:
        replay: The model.
        xi: Its free parameters (D,).
        windows: Of recordings (N).
        horizons: Control steps after which they are compared.
        sigma: Noise of the sensors (2 nv,).
        seed: Of the draws.
        draws: How many.
        force: Typical generalized forces (nv,), by a share of which the model is pushed aside; None: it is not.
    """
    nv, rng = replay.nv, np.random.default_rng(seed)
    steps = np.array(horizons) - 1
    pushed = aside(force, nv, draws)
    found = []
    for draw in range(draws):
        push = pushed[draw % len(pushed)][None]
        a = replay.predict(xi[None], windows, push, steps)[0]
        moved = started_beside(replay, windows, rng.normal(size=(len(windows), 2 * nv)) * sigma)
        apart = replay.sim.states.difference(replay.predict(xi[None], moved, push, steps)[0], a)
        found.append(replay.by_dof(apart + sigma * rng.normal(size=apart.shape)))
    return np.array(found)


def aside(force: Array | None, nv: int, most: int = MODELS) -> Array:
    """Generalized forces (models, nv), of typical ones (nv,), at most so many; none at all if None."""
    if force is None:
        return np.zeros((1, nv))
    return ASIDE * force * np.random.default_rng(_PUSHES).normal(size=(MODELS, nv))[:most]


def loudness(noise: Array, residuals: Array, floor: Array) -> Loudness:
    """How loud windows are, relative to each other.

    The logarithms of the variances of the noise are drawn together by as much as so few draws scatter, so that windows
    that are alike have loudness one. Then they are drawn together by as much as the residuals do not follow them: where
    a gap outweighs the noise, and where the noise of the sensors was overestimated, loud windows have residuals like
    any other.

    Args:
        noise: Draws of the noise of every window (draws, N, nv, C).
        residuals: Of the base model (N, nv, C).
        floor: Smallest residual believed (nv, C); noise below it counts as that.
    """
    variance = _variance(noise) + floor**2
    logs = np.log(np.maximum(variance, 1e-300))
    logs -= logs.mean(0)
    scatter = np.maximum(logs.var(0), 1e-300)
    # a sum of as many squares of a Gaussian has a logarithm that varies by this
    logs *= np.clip(1.0 - float(polygamma(1, len(noise) / 2)) / scatter, 0.0, 1.0)
    relative = np.exp(_followed(logs, residuals, floor)[:, None] * logs)
    return Loudness(np.sqrt(relative / relative.mean(0)))


def _variance(noise: Array) -> Array:
    """Mean squares over the draws that did not diverge; windows in which all did are as loud as the loudest."""
    sound = np.isfinite(noise)
    count = sound.sum(0)
    variance = np.square(noise, out=np.zeros_like(noise), where=sound).sum(0) / np.maximum(count, 1)
    return np.where(count > 0, variance, variance.max(0))


def _followed(logs: Array, residuals: Array, floor: Array) -> Array:
    """Slope of the logarithms of squared residuals over those of the noise, by degree of freedom (nv,), in [0, 1]."""
    sound = np.isfinite(residuals)
    squares = np.log(np.where(sound, residuals, 0.0) ** 2 + floor**2 + 1e-300)
    weight = sound / np.maximum(sound.sum(0), 1)
    apart = (squares - (weight * squares).sum(0)) * weight
    centred = logs - (weight * logs).sum(0)
    slope = (apart * centred).sum((0, 2)) / np.maximum((weight * centred**2).sum((0, 2)), 1e-300)
    return np.clip(slope, 0.0, 1.0)
