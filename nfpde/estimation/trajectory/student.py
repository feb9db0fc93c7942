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
    best: tuple[float, Student] | None = None
    for degrees in DEGREES:
        whitener, score = _scatter(r, float(degrees), n / left, full=n >= 5 * channels)
        score -= tails_cost(float(degrees), n) / n if thrifty else 0.0
        if best is None or score > best[0]:
            best = score, Student(whitener / floor[:, None], float(degrees))
    if best is None:
        raise RuntimeError("no degrees of freedom were tried")
    return best[1]


def tails_cost(degrees: float, n: int) -> float:
    """What tails must gain to be believed, in n residuals: one number more by Schwarz's criterion [nats]."""
    return 0.5 * np.log(n) if degrees < GAUSSIAN else 0.0


def _scatter(r: Array, degrees: float, inflation: float, *, full: bool) -> tuple[Array, float]:
    """Whitening matrix of r (n, C) by EM at given degrees of freedom, and the mean log density [nats]."""
    n, channels = r.shape
    weights = np.ones(n)
    whitener, squares = np.eye(channels), np.zeros(n)
    for _ in range(30):
        scatter = inflation * (r.T * weights) @ r / n
        values, vectors = np.linalg.eigh(scatter if full else np.diag(np.diag(scatter)))
        whitener = vectors / np.sqrt(np.maximum(values, 1.0))
        squares = ((r @ whitener) ** 2).sum(1)
        updated = (degrees + channels) / (degrees + squares)
        if np.abs(updated - weights).max() < 1e-3:
            break
        weights = updated
    constant = gammaln((degrees + channels) / 2) - gammaln(degrees / 2) - 0.5 * channels * np.log(degrees * np.pi)
    density = constant + np.linalg.slogdet(whitener)[1] - 0.5 * (degrees + channels) * np.log1p(squares / degrees)
    return whitener, float(density.mean())
