"""How large a gap is: the floor that noise puts under predictions, and the gap in its units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.noise import KAPPA

Array = NDArray[np.float64]

CAPPED = 0.02
"""Share of the largest squares of a channel that are capped where contacts are."""

FLOOR_ERROR = 0.1
"""Error to be expected of the noise floor, and gap to be left alone, in units of gap: see `Yardstick`."""

NEAR_FLOOR = 1.5
"""A gap that is not surely above this multiple of the noise floor is closed: the floor itself is an estimate."""

_RARE = 10
"""Windows looked at for a gap that shows in few of them."""

_DRAWS = 500

_ROUNDING_SEED = 0
"""Of the draws of rounding."""


@dataclass(frozen=True, eq=False)
class Yardstick:
    """Turns residuals into a gap: mean squares in units of noise.

    scale: what counts as one, by channel (nv, C): the noise that sensors put on a prediction, and `KAPPA` of what the
        base model leaves, below which differences are of no interest
    noise: residuals that noise and rounding alone give (draws, N, nv, C)
    capped: share of the windows whose squares are capped, by channel. Where a contact opens or closes a residual
        jumps, and a few of those would outweigh everything else; in smooth motion nothing is capped, as what acts in
        few windows shows in nothing else
    precision: what simulations of the same motion may differ by (nv, C), which is in the noise
    """

    scale: Array
    noise: Array
    capped: float = CAPPED
    precision: Array | float = 0.0

    @classmethod
    def of(cls, noise: Array, base: Array, capped: float = CAPPED, precision: Array | float = 0.0) -> Yardstick:
        """From residuals that noise alone gives (draws, N, nv, C) and those of the base model (N, nv, C).

        With `precision` (nv, C), differences of rounding are none of interest either, though nothing else is there:
        they are noise, too.
        """
        rounded = noise + precision * np.random.default_rng(_ROUNDING_SEED).normal(size=noise.shape)
        return cls(_scale(rounded, base, capped), rounded, capped, precision)

    def beside(self, base: Array) -> Yardstick:
        """The same noise beside what another base model leaves (N, nv, C)."""
        return replace(self, scale=_scale(self.noise, base, self.capped))

    @cached_property
    def rounding(self) -> float:
        """Gap that differences of rounding leave: one where there is neither noise nor much of a gap."""
        return float(np.mean(np.square(self.precision / self.scale)))

    def squares(self, residuals: Array) -> Array:
        """Squared residuals in units of noise (N, nv, C)."""
        return calm((residuals / self.scale) ** 2, self.capped)

    def gap(self, residuals: Array) -> Array:
        """Gap of every window (N,)."""
        return self.squares(residuals).mean((1, 2))

    @cached_property
    def floor(self) -> Array:
        """Squares that noise alone leaves, on average over its draws (N, nv, C)."""
        return np.mean([self.squares(draw) for draw in self.noise], axis=0)


def _scale(noise: Array, base: Array, capped: float) -> Array:
    """What counts as one (nv, C): noise (draws, N, nv, C), and `KAPPA` of what a base model leaves (N, nv, C)."""
    every = noise.reshape(-1, *noise.shape[2:])
    total = calm(every**2, capped).mean(0) + KAPPA**2 * calm(base**2, capped).mean(0)
    return np.sqrt(np.maximum(total, 1e-12 * total.max(initial=1e-300)))


def near_floor(floor: float) -> float:
    """The gap below which noise may leave all of it, where its floor is known to a factor only."""
    return NEAR_FLOOR * floor + FLOOR_ERROR


def calm(squares: Array, capped: float = CAPPED) -> Array:
    """Squares (N, nv, C) with a share of the largest in every channel, and what diverged, brought down to its bound."""
    filled = np.where(np.isfinite(squares), squares, np.inf)
    bound = np.quantile(filled, 1.0 - capped, axis=0, method="lower")
    sound = np.max(squares, axis=0, initial=0.0, where=np.isfinite(squares))
    bound = np.where(np.isfinite(bound), bound, np.where(sound > 0, sound, 1.0))
    return np.minimum(filled, bound)


def rare(gap: Array, noise: Array, block: NDArray[np.intp]) -> float:
    """Probability of as many windows as far beyond all noise, if there were nothing but noise.

    Of n draws of noise and as many windows that are noise too, k windows lie beyond f times the largest draw with
    probability (1 + f)^-k where tails fall off like 1 / x: the number beyond has a Poisson distribution, whose mean is
    exponentially distributed. Tails of noise with a mean are lighter, and the probability is smaller.

    Args:
        gap: Of every window (N,).
        noise: Gap that noise alone gives, N draws at least.
        block: Groups of neighbouring windows (N,), of which the largest counts: neighbours resemble each other.
    """
    largest = np.sort([gap[block == g].max() for g in np.unique(block)])[::-1][:_RARE]
    beyond = largest / max(float(noise.max(initial=0.0)), 1e-300)
    count = np.arange(1, len(beyond) + 1)
    return float(min(1.0, len(beyond) * np.min((1.0 + beyond) ** -count, initial=1.0)))


def shrink_interval(before: Array, after: Array, block: NDArray[np.intp], seed: int) -> tuple[float, float, float]:
    """1 - after/before of the mean gap, with a 95 % interval by resampling blocks of windows (N,)."""
    drawn = _resampled(np.stack([before, after], axis=1), block, seed)
    shrink = 1.0 - drawn[:, 1] / np.maximum(drawn[:, 0], 1e-300)
    low, high = np.quantile(shrink, [0.025, 0.975])
    return float(1.0 - after.sum() / max(float(before.sum()), 1e-300)), float(low), float(high)


def least_ratio(gap: Array, floor: Array, block: NDArray[np.intp], seed: int) -> Array:
    """Lower ends of 95 % intervals of means of columns over those of others (N, K) to (K,), by resampling blocks."""
    above, below = np.hsplit(_resampled(np.hstack([gap, floor]), block, seed), 2)
    return np.quantile(above / np.maximum(below, 1e-300), 0.025, axis=0)


def _resampled(columns: Array, block: NDArray[np.intp], seed: int) -> Array:
    """Sums of columns (N, K) over as many blocks as there are, drawn with replacement (draws, K)."""
    sums = np.array([columns[block == g].sum(0) for g in np.unique(block)])
    rng = np.random.default_rng(seed)
    drawn = rng.integers(len(sums), size=(_DRAWS, len(sums)))
    return np.array([sums[row].sum(0) for row in drawn])
