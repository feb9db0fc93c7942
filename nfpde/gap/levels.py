"""How large a gap is: the floor that noise puts under predictions, and the gap in its units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.noise import KAPPA
from nfpde.gap.recordings import Recordings
from nfpde.gap.replay import Replay, started_beside

Array = NDArray[np.float64]

_DRAWS = 500


def noise_residuals(
    replay: Replay, xi: Array, windows: Windows, recordings: Recordings, sigma: Array, seed: int
) -> Array:
    """Residuals that sensor noise alone gives, a draw for every window (N, nv, C).

    Noise at a window's start spreads as the simulation carries it on; noise at its end adds to that.
    """
    model, nv = replay.sim.model, replay.nv
    rng = np.random.default_rng(seed)
    moved = started_beside(model, windows, rng.normal(size=(len(windows), 2 * nv)) * sigma)
    steps = np.array(recordings.horizons) - 1
    a = replay.predict(xi[None], windows)[0][:, steps]
    b = replay.predict(xi[None], moved)[0][:, steps]
    apart = replay.sim.states.difference(b, a)
    return replay.by_dof(apart + sigma * rng.normal(size=apart.shape))


@dataclass(frozen=True, eq=False)
class Yardstick:
    """Turns residuals into a gap: mean squares in units of noise.

    scale: what counts as one, by channel (nv, C): the noise that sensors put on a prediction, and `KAPPA` of what the
        base model leaves, below which differences are of no interest
    noise: residuals that noise alone gives (N, nv, C)
    """

    scale: Array
    noise: Array

    @classmethod
    def of(cls, noise: Array, base: Array) -> Yardstick:
        """From residuals that noise alone gives (N, nv, C) and those of the base model."""
        total = calm(noise**2).mean(0) + KAPPA**2 * calm(base**2).mean(0)
        return cls(np.sqrt(np.maximum(total, 1e-12 * total.max(initial=1e-300))), noise)

    def squares(self, residuals: Array) -> Array:
        """Squared residuals in units of noise (N, nv, C), the largest fiftieth of every channel capped.

        Where a contact opens or closes a residual jumps; a few of those would outweigh everything else.
        """
        return calm((residuals / self.scale) ** 2)

    def gap(self, residuals: Array) -> Array:
        """Gap of every window (N,)."""
        return self.squares(residuals).mean((1, 2))


def calm(squares: Array) -> Array:
    """Squares (N, nv, C) with the largest fiftieth of every channel, and what diverged, brought down to its bound."""
    filled = np.where(np.isfinite(squares), squares, np.inf)
    bound = np.quantile(filled, 0.98, axis=0, method="lower")
    bound = np.where(np.isfinite(bound), bound, np.nanmax(squares, initial=1.0))
    return np.minimum(filled, bound)


def shrink_interval(before: Array, after: Array, block: NDArray[np.intp], seed: int) -> tuple[float, float, float]:
    """1 - after/before of the mean gap, with a 95 % interval by resampling blocks of windows (N,)."""
    groups = np.unique(block)
    sums = np.array([[before[block == g].sum(), after[block == g].sum()] for g in groups])
    rng = np.random.default_rng(seed)
    drawn = sums[rng.integers(len(groups), size=(_DRAWS, len(groups)))].sum(1)
    shrink = 1.0 - drawn[:, 1] / np.maximum(drawn[:, 0], 1e-300)
    low, high = np.quantile(shrink, [0.025, 0.975])
    return float(1.0 - after.sum() / max(float(before.sum()), 1e-300)), float(low), float(high)
