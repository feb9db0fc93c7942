"""Independent residuals with heavy tails, learned from what the best parameters leave unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

Array = NDArray[np.float64]

GAUSSIAN = 1e6
"""Degrees of freedom from which Student's t is a Gaussian."""

DEGREES = np.array([2.5, 3.0, 4.0, 6.0, 10.0, 20.0, 50.0, GAUSSIAN])
"""Degrees of freedom tried."""


@dataclass(frozen=True, eq=False)
class Student:
    """A window's residual r (C,) is multivariate Student t with scatter S: heavy tails where contacts amplify noise.

    Reference: Lange, Little, Taylor, Robust statistical modeling using the t distribution, JASA 1989.

    whitener: W with W W' = inverse of S                                   (C, C)
    degrees: degrees of freedom; `GAUSSIAN` is a Gaussian
    """

    whitener: Array
    degrees: float

    def cost(self, squares: Array) -> Array:
        """Twice the negative log density, up to a constant, of squared white residuals m = |r W|^2 (...)."""
        return (self.degrees + len(self.whitener)) * np.log1p(squares / self.degrees)

    def weight(self, squares: Array) -> Array:
        """What a window counts in least squares: one in a Gaussian, little far out in the tails."""
        return (self.degrees + len(self.whitener)) / (self.degrees + squares)


def learn_student(residuals: Sequence[Array], fitted: int, floor: Array, *, thrifty: bool = True) -> Student:
    """Maximum-likelihood noise of the residuals of all robots at their best parameters.

    Sensor noise in a window's start spreads over the channels of its end, so the scatter is a full matrix where there
    are enough windows to estimate one; otherwise its diagonal. It is corrected for the degrees of freedom that the fit
    has used up.

    Args:
        residuals: (n_g, C) for every robot; windows that diverged (NaN) are left out.
        fitted: number of parameters fitted to them.
        floor: standard deviation below which no channel is believed, (C,).
        thrifty: whether tails must pay for themselves; not where windows that no fit saw are judged, one of which may
            surprise a Gaussian.

    Returns:
        The noise.
    """
    r = np.concatenate(residuals)
    r = r[np.isfinite(r).all(1)] / floor
    n, channels = r.shape
    left = max(n - fitted / channels, 0.1 * n)
    whiteners, scores = _scatters(r, DEGREES, n / left, full=n >= 5 * channels)
    if thrifty:
        scores = scores - np.array([tails_cost(float(degrees), n) for degrees in DEGREES]) / n
    best = int(np.argmax(scores))
    return Student(whiteners[best] / floor[:, None], float(DEGREES[best]))


def tails_cost(degrees: float, n: int) -> float:
    """What tails must gain to be believed, in n residuals: one number more by Schwarz's criterion [nats]."""
    return 0.5 * np.log(n) if degrees < GAUSSIAN else 0.0


def _scatters(r: Array, degrees: Array, inflation: float, *, full: bool) -> tuple[Array, Array]:
    """Whitening matrices (K, C, C) of r (n, C) by EM at degrees of freedom (K,), and mean log densities (K,) [nats]."""
    n, channels = r.shape
    weights, squares = np.ones((len(degrees), n)), np.zeros((len(degrees), n))
    whiteners = np.tile(np.eye(channels), (len(degrees), 1, 1))
    going = np.arange(len(degrees))
    for _ in range(30):
        scatter = inflation * (r.T * weights[going, None]) @ r / n
        values, vectors = np.linalg.eigh(scatter if full else scatter * np.eye(channels))
        whiteners[going] = vectors / np.sqrt(np.maximum(values, 1.0))[:, None]
        squares[going] = ((r @ whiteners[going]) ** 2).sum(-1)
        updated = (degrees[going, None] + channels) / (degrees[going, None] + squares[going])
        moving = np.abs(updated - weights[going]).max(1) >= 1e-3
        going = going[moving]
        if not len(going):
            break
        weights[going] = updated[moving]
    constant = gammaln((degrees + channels) / 2) - gammaln(degrees / 2) - 0.5 * channels * np.log(degrees * np.pi)
    tails = 0.5 * (degrees[:, None] + channels) * np.log1p(squares / degrees[:, None])
    return whiteners, constant + np.linalg.slogdet(whiteners)[1] - tails.mean(1)
