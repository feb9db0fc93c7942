"""To how many degrees of freedom the noise is known by which the parameters are told."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.components import Judged, squares_by_window, visible

Array = NDArray[np.float64]

SMALLEST = 1e-6
"""Share of the degrees of freedom of a channel below which the rest is rounding."""


def degrees_left(best: Judged, slopes: Array, kicks: Array | None) -> float:
    """Degrees of freedom of the noise by which parameters of a robot are told, in the direction that has the fewest.

    Satterthwaite's (An approximate distribution of estimates of variance components, Biometrics Bulletin 2, 1946), as
    Kenward and Roger use them (Small sample inference for fixed effects from restricted maximum likelihood, Biometrics
    53, 1997). What is left of the variance of a direction is a sum over the channels of a state, in which errors of
    measured states and of the simulation are made, and each channel's variances have the degrees of freedom that the
    fit has left there. What the bounds have of it is known.

    Args:
        best: the scatter, with what it finds.
        slopes: derivative of every window's end by its start            (N, C, ndiff)
        kicks: see `carried_on`; None where the errors of the simulation have a full covariance    (C, C)

    Returns:
        At least a small number; infinity where nothing is told of any parameter.
    """
    scatter, used, chains = best.scatter, best.used, best.factor.chains
    n, channels, ndiff = slopes.shape
    root = _root(scatter.process, kicks, ndiff)

    def by_channel(u: Array) -> Array:
        """What solutions u (N, C) have of the variance of each channel, window by window (N, ndiff)."""
        process = ((u @ root) ** 2).reshape(n, -1, ndiff).sum(1)
        return scatter.sensor * squares_by_window(chains, u, slopes) + process

    sensor, blocks = visible(best.factor, best.weights, slopes)
    total = scatter.sensor * sensor + (root * (blocks @ root)).sum(0).reshape(-1, ndiff).sum(0)
    lost = sum((by_channel(column).sum(0) for column in np.moveaxis(used.columns, 2, 0)), np.zeros(ndiff))
    left = np.maximum(np.maximum(total - lost, SMALLEST * total), np.finfo(np.float64).tiny)
    if kicks is None:
        # each number of a window is told from the others by correlations, which are learned too
        left = left * max(1 - (channels - 1) / n, SMALLEST)
    most = 0.0
    for column in np.moveaxis(used.columns, 2, 0):
        shares = np.zeros((int(used.robot.max()) + 1, ndiff))
        np.add.at(shares, used.robot, by_channel(column))
        most = max(most, float((shares**2 / left).sum(1).max()))
    return 1 / most if most > 0 else np.inf


def _root(process: Array, kicks: Array | None, ndiff: int) -> Array:
    """A root R of the covariance of what a window's simulation lacks, R R', whose columns belong to a channel each."""
    if kicks is not None:
        return kicks * np.sqrt(np.tile(np.diag(process)[:ndiff], len(kicks) // ndiff))
    values, vectors = np.linalg.eigh(process)
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
