"""How well a noise model foretells the positions that come next.

Velocities that were filtered, delayed or computed from positions have errors that the positions share, which no noise
model here knows: it may be likelier with them and know less. What every model must do is to foretell the positions; one
that does it worse with the velocities than another one does without them believes too much (prequential comparison:
Dawid, Statistical theory: the prequential approach, JRSS A 147, 1984).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from nfpde.estimation.trajectory.chains import Chains
from nfpde.estimation.trajectory.likeliest import innovations_of
from nfpde.estimation.trajectory.noise import Scatter
from nfpde.estimation.trajectory.student import standard_constant

Array = NDArray[np.float64]

CHANCE = 1e-3
"""Probability that velocities that tell something are not believed."""

FEWEST = 20
"""Windows without which nothing is said of the velocities."""


def foretold(scatter: Scatter, chains: Chains, slopes: Array, residuals: Array, positions: NDArray[np.bool_]) -> Array:
    """Log density of every window's positions, given all that the windows before it show [nats], (N,).

    NaN where a window diverged.

    Args:
        scatter: the noise.
        chains: which window follows which.
        slopes: derivative of every window's end by its start            (N, C, ndiff)
        residuals: of the best parameters; NaN where a window diverged    (N, C)
        positions: which channels of a state are positions               (ndiff,)
    """
    weights = np.isfinite(residuals).all(1).astype(float)
    weights = scatter.gain_weight(innovations_of(scatter, chains, slopes, residuals, weights)[2])
    factor, innovations, squares = innovations_of(scatter, chains, slopes, residuals, weights)
    sound = np.isfinite(squares)
    shown = np.flatnonzero(np.tile(positions, residuals.shape[1] // len(positions)))
    spread = scatter.scale * factor.spread[sound][:, shown[:, None], shown]
    rows = innovations[sound][:, shown]
    m = np.einsum("ni,ni->n", rows, np.linalg.solve(spread, rows[..., None])[..., 0])
    degrees, count = scatter.degrees, len(shown)
    tails = standard_constant(degrees, count) - 0.5 * (degrees + count) * np.log1p(m / degrees)
    found = np.full(len(residuals), np.nan)
    found[sound] = tails - 0.5 * np.linalg.slogdet(spread)[1]
    return found


def surely_better(one: Array, other: Array) -> bool:
    """Whether one model foretells windows (N,) better than another by more than chance does in a thousand recordings.

    Window by window: innovations of a model that knows the noise are independent.
    """
    apart = one - other
    apart = apart[np.isfinite(apart)]
    if len(apart) < FEWEST or not apart.mean() > 0:
        return False
    return float(np.asarray(wilcoxon(apart, alternative="greater"))[1]) < CHANCE
