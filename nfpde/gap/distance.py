"""How far the simulated states lie from the recorded ones, as distributions: optimal transport on held-out windows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.report import Distance
from nfpde.ot import wasserstein
from nfpde.sim import StateSpace

Array = NDArray[np.float64]

MOST_POINTS = 400
"""Windows compared at most, evenly over all: exact transport takes about the square of them."""

_STILL = 1e-2
"""A channel that spreads by less than this share of the widest of its kind is taken to spread by that much: nobody
minds what hardly moves as much as what does."""


def distance(
    states: StateSpace, windows: Windows, ends: list[Array], noise: Array, sigma: Array | float = 0.0
) -> Distance:
    """Wasserstein distances of order 1 between recorded and simulated states at the windows' ends.

    Each channel is divided by its standard deviation over the recorded ends, so that 1 is a shift of everything in one
    channel by as much as it varies; one that moves by less than its sensor's noise is divided by that. Windows start at
    the same recorded states on both sides; those that diverge in any of the simulations, or from a start that noise
    moved, are left out of all.

    Args:
        states: Layout of the states.
        windows: Held-out windows.
        ends: Predicted ends (N, nx) of the nominal model, with parameters, with effects.
        noise: Differences at the ends that sensor noise alone gives (N, 2 nv).
        sigma: Noise of the sensors (2 nv,).
    """
    sound = np.flatnonzero(np.all([np.isfinite(e).all(1) for e in (*ends, noise)], axis=0))
    if not len(sound):
        nothing = float("nan")
        return Distance(nothing, nothing, nothing, nothing, 0)
    chosen = sound[np.unique(np.linspace(0, len(sound) - 1, MOST_POINTS).round().astype(int))]
    recorded = windows.target[chosen, -1]
    # one reference for all, in whose tangent space rotations are compared
    reference = np.broadcast_to(recorded[:1], recorded.shape)
    real = states.difference(recorded, reference)
    scale = _spread(real, states.nv, sigma)
    simulated = [states.difference(e[chosen], reference) for e in ends]
    # a turn that noise adds to one of nearly half a turn goes on at the other side, as a simulated one does
    noisy = states.difference(states.moved(recorded, noise[chosen]), reference)
    found = [wasserstein(real / scale, s / scale) for s in (*simulated, noisy)]
    return Distance(found[0], found[1], found[2], found[3], len(chosen))


def _spread(points: Array, nv: int, sigma: Array | float) -> Array:
    """Standard deviation of every channel (N, 2 nv), by which it is divided; see `_STILL` for one that stands still."""
    spread = np.maximum(points.std(0), sigma)
    for kind in (slice(0, nv), slice(nv, None)):
        spread[kind] = np.maximum(spread[kind], _STILL * spread[kind].max(initial=0.0))
    return np.where(spread > 0, spread, 1.0)
