"""Independent residuals with heavy tails, learned from what the best parameters leave unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
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

    @cached_property
    def log_constant(self) -> float:
        """The part of a log density that does not depend on the residual [nats]."""
        channels, volume = len(self.whitener), float(np.linalg.slogdet(self.whitener)[1])
        if self.degrees >= GAUSSIAN:
            return volume - 0.5 * channels * np.log(2 * np.pi)
        return volume + float(standard_constant(self.degrees, channels))


def standard_constant(degrees: ArrayLike, channels: int) -> Array:
    """Log density of Student's t with unit scatter over so many channels where it is largest [nats]."""
    nu = np.asarray(degrees, dtype=np.float64)
    return gammaln((nu + channels) / 2) - gammaln(nu / 2) - 0.5 * channels * np.log(nu * np.pi)


def learn_student(residuals: Sequence[Array], fitted: float, floor: Array) -> Student:
    """Maximum-likelihood noise of the residuals of all robots at their best parameters.

    Sensor noise in a window's start spreads over the channels of its end, so the scatter is a full matrix where there
    are enough windows to estimate one; otherwise its diagonal. It is corrected for the degrees of freedom that the fit
    has used up.

    Args:
        residuals: (n_g, C) for every robot; windows that diverged (NaN) are left out.
        fitted: number of parameters fitted to them.
        floor: standard deviation below which no channel is believed, (C,).

    Returns:
        The noise.
    """
    r = np.concatenate(residuals)[:, None]
    return _learned(r, fitted, floor[None], thrifty=True)[0]


def learn_students(residuals: Array, fitted: float, floor: Array) -> list[Student]:
    """What `learn_student` learns of the residuals of several degrees of freedom, each by itself.

    Tails need not pay for themselves: one of the windows that no fit saw, which are judged, may surprise a Gaussian.

    Args:
        residuals: (n, P, C); windows that diverged (NaN) are left out.
        fitted: number of parameters fitted to each.
        floor: standard deviation below which no channel is believed, (P, C).
    """
    return _learned(residuals, fitted, floor, thrifty=False)


def _learned(residuals: Array, fitted: float, floor: Array, *, thrifty: bool) -> list[Student]:
    r = np.moveaxis(residuals / floor, 1, 0)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(r).all(2))
    n, channels = known.sum(1), r.shape[2]
    left = np.maximum(n - fitted / channels, 0.1 * n)
    r = np.where(known[..., None], r, 0.0)
    whiteners, scores = _scatters(r, known, DEGREES, n / left, n >= 5 * channels)
    if thrifty:
        costs = [[tails_cost(float(degrees), int(count)) / count for degrees in DEGREES] for count in n]
        scores = scores - np.array(costs)
    best = scores.argmax(1)
    return [Student(whiteners[p, k] / floor[p][:, None], float(DEGREES[k])) for p, k in enumerate(best)]


def tails_cost(degrees: float, n: int) -> float:
    """What tails must gain to be believed, in n residuals: one number more by Schwarz's criterion [nats]."""
    return 0.5 * np.log(n) if degrees < GAUSSIAN else 0.0


def _scatters(r: Array, known: NDArray[np.bool_], degrees: Array, inflation: Array, full: Array) -> tuple[Array, Array]:
    """Whitening matrices by EM of several residuals at several degrees of freedom, and what these are worth.

    Args:
        r: Residuals (P, n, C), zero where they are not known.
        known: Which of them are (P, n).
        degrees: Degrees of freedom tried (K,).
        inflation: Factor of each scatter (P,).
        full: Whether its channels are correlated (P,).

    Returns:
        Whitening matrices (P, K, C, C), and mean log densities [nats] (P, K).
    """
    (count, n, channels), kinds = r.shape, len(degrees)
    which, nu = np.repeat(np.arange(count), kinds), np.tile(degrees, count)
    weights, squares = known[which].astype(float), np.zeros((count * kinds, n))
    whiteners = np.tile(np.eye(channels), (count * kinds, 1, 1))
    total, correlated = known.sum(1), np.where(full[:, None, None], 1.0, np.eye(channels))
    going, rounding = np.arange(count * kinds), channels * np.finfo(np.float64).eps
    for _ in range(30):
        own, of = r[which[going]], which[going]
        scatter = (own * weights[going, :, None]).swapaxes(1, 2) @ own
        values, vectors = np.linalg.eigh((inflation / total)[of, None, None] * scatter * correlated[of])
        # channels that are nearly dependent have eigenvalues that are rounding errors of the largest
        least = np.maximum(full[of, None] * rounding * values[:, -1:], 1.0)
        whiteners[going] = vectors / np.sqrt(np.maximum(values, least))[:, None]
        squares[going] = ((own @ whiteners[going]) ** 2).sum(-1)
        updated = known[of] * (nu[going, None] + channels) / (nu[going, None] + squares[going])
        moving = np.abs(updated - weights[going]).max(1) >= 1e-3
        going = going[moving]
        if not len(going):
            break
        weights[going] = updated[moving]
    tails = 0.5 * (nu + channels) * (known[which] * np.log1p(squares / nu[:, None])).sum(1) / total[which]
    scores = standard_constant(nu, channels) + np.linalg.slogdet(whiteners)[1] - tails
    return whiteners.reshape(count, kinds, channels, channels), scores.reshape(count, kinds)
