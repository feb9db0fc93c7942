"""The likeliest sizes of the errors of states and of the simulation: the restricted likelihood, and the way uphill."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.estimation.trajectory.accelerate import Anderson
from nfpde.estimation.trajectory.chains import Chains, Factor
from nfpde.estimation.trajectory.components import Judged, at_least, extrapolated, kicked, rescaled
from nfpde.estimation.trajectory.freedom import MOST_USED, Fitted, Used
from nfpde.estimation.trajectory.noise import Scatter
from nfpde.estimation.trajectory.student import DEGREES, standard_constant, tails_cost

Array = NDArray[np.float64]

ITERATIONS = 40
"""Steps towards the likeliest sizes, at most; a later call goes on from there."""

POLISHING = 12
"""Steps from there on that learn from each other, at most: a small kind of error follows the others' steps slowly, and
may have far to go while none of them gains much."""

STILL = 4
"""Such steps in a row that gain less than `ENOUGH`, after which none will gain more: the first know nothing yet."""

MOST = float(np.log(100.0))
"""Log of the factor by which such a step may change a variance."""

AWAKE = 1e-3
"""Share of the squares of the residuals that a kind of error begins with, at least."""

ENOUGH = 0.02
"""Gain in log likelihood [nats] of an iteration below which no statistic could tell one from the next."""


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The restricted likelihood of a scatter, of N windows.

    residuals: of the best parameters; NaN where a window diverged         (N, C)
    slopes: derivative of every window's end by its start                  (N, C, ndiff)
    chains: which window follows which
    fitted: what was fitted to the residuals
    floors: standard deviations below which no error of a state (ndiff,) and of the simulation (C,) is believed
    """

    residuals: Array
    slopes: Array
    chains: Chains
    fitted: Fitted
    floors: tuple[Array, Array]

    def judged(self, scatter: Scatter, weights: Array) -> Judged:
        """What a scatter is worth, with the scale and the tails that fit it best; weights (N,) as of `Factor`."""
        factor, innovations, squares = innovations_of(scatter, self.chains, self.slopes, self.residuals, weights)
        used = self.fitted.used(factor, weights, scatter.scale)
        scatter, score = _tails(scatter, factor, squares, used, _least_scale(scatter, self.floors))
        return Judged(scatter, score, scatter.gain_weight(squares), factor, innovations, used)

    def likeliest(self, start: Scatter, kicks: Array | None) -> Judged:
        """The likeliest scatter from `start` on; kicks as of `rescaled`."""
        best = self.judged(start, np.isfinite(self.residuals).all(1).astype(float))
        best = self.judged(best.scatter, best.weights)
        if kicks is not None:
            best = self._awake(best, kicks)
        stride = 1
        for _ in range(ITERATIONS):
            updated = rescaled(best, self.slopes, kicks)
            tried = self.judged(extrapolated(best.scatter, updated, stride, self.floors), best.weights)
            gain = tried.score - best.score
            best = tried if gain > 0 else best
            if gain >= ENOUGH:
                stride = min(2 * stride, 64)
            elif stride > 1 or (kicks is None and gain > 0):
                stride = 1
            else:
                break
        return best if kicks is None else self._polished(best, kicks)

    def _polished(self, best: Judged, kicks: Array) -> Judged:
        """From where steps of the MM algorithm gain little, by steps that learn from each other."""
        memory, still = Anderson(), 0
        for _ in range(POLISHING):
            place = np.log(_variances(best.scatter))
            move = np.log(_variances(rescaled(best, self.slopes, kicks))) - place
            for step in (memory.step(place, move), move):
                variances = np.exp(place + np.clip(step, -MOST, MOST))
                tried = self.judged(self._with_variances(best.scatter, variances, kicks), best.weights)
                if tried.score > best.score:
                    break
                memory.forget()
            else:
                break
            still = still + 1 if tried.score < best.score + ENOUGH else 0
            best = tried
            if still == STILL:
                break
        return best

    def _awake(self, best: Judged, kicks: Array) -> Judged:
        """The same, but kinds of error that should grow and are next to nothing large enough to gain from it.

        While parameters are wrong one kind may take all, and leave another so small that a step of the MM algorithm,
        which multiplies it, gains less than `ENOUGH`.
        """
        sound = np.isfinite(self.residuals).all(1)
        if not sound.any():
            return best
        ndiff = self.slopes.shape[2]
        squares = AWAKE * np.median(self.residuals[sound] ** 2, axis=0) / best.scatter.scale
        reach = 1 + (self.slopes[:, -ndiff:] ** 2).sum(2).mean(0)
        least = np.concatenate([squares[-ndiff:] / reach, squares[:ndiff]])
        old, new = _variances(best.scatter), _variances(rescaled(best, self.slopes, kicks))
        grows = (new > old) & (old < least)
        if not grows.any():
            return best
        grown = self._with_variances(best.scatter, np.where(grows, least, old), kicks)
        tried = self.judged(grown, best.weights)
        return tried if tried.score > best.score else best

    def _with_variances(self, scatter: Scatter, variances: Array, kicks: Array) -> Scatter:
        """The same with other variances, as of `_variances`."""
        sensor, process = np.split(variances, 2)
        process = at_least(kicked(process, kicks), self.floors[1])
        return replace(scatter, sensor=np.maximum(sensor, self.floors[0] ** 2), process=process)


def innovations_of(
    scatter: Scatter, chains: Chains, slopes: Array, residuals: Array, weights: Array
) -> tuple[Factor, Array, Array]:
    """Factor, innovations (N, C), and their squares by the Gaussian core (N,), NaN where a window diverged."""
    sound = np.asarray(np.isfinite(residuals).all(1))
    factor = Factor.of(chains, *scatter.covariances(slopes), weights)
    innovations = factor.innovations(np.where(sound[:, None], residuals, 0.0))
    squares = np.einsum("ni,nij,nj->n", innovations, factor.inverse, innovations, optimize=True)
    return factor, innovations, np.where(sound, squares, np.nan)


def _variances(scatter: Scatter) -> Array:
    """Those of the states' errors, then those of the simulation's in a control step, (2 ndiff,)."""
    ndiff = len(scatter.sensor)
    # the first step of a window shows no errors but its own
    return np.maximum(np.concatenate([scatter.sensor, np.diag(scatter.process)[:ndiff]]), np.finfo(np.float64).tiny)


def _least_scale(scatter: Scatter, floors: tuple[Array, Array]) -> float:
    """The smallest scale that leaves no error of a state, and no direction of the others, below its floor."""
    # the least eigenvalue by way of Cholesky's factor, in which channels of very different size keep their digits
    lower = np.linalg.cholesky(scatter.process / np.outer(floors[1], floors[1]))
    of_process = float(np.linalg.norm(np.linalg.inv(lower), 2)) ** 2
    of_sensors = floors[0] ** 2 / np.maximum(scatter.sensor, 1e-300)
    return max(of_process, float(of_sensors.max(initial=0.0)))


def _tails(scatter: Scatter, factor: Factor, squares: Array, used: Used, least: float) -> tuple[Scatter, float]:
    """The degrees of freedom and the scale that fit the squares of the innovations best, and the log likelihood.

    It is the restricted one: what the fit has used up of the squares says nothing of the scale.
    """
    sound = np.isfinite(squares)
    m, channels = squares[sound], int(factor.spread.shape[1])
    spent = min(used.total, MOST_USED * m.size * channels)
    inflation = m.size * channels / (m.size * channels - spent)
    half_det = 0.5 * (np.linalg.slogdet(factor.spread[sound])[1].sum() + used.log_det)
    best = (scatter, -np.inf)
    for degrees in DEGREES:
        scale = 1.0
        for _ in range(50):
            updated = float(
                ((degrees + channels) / (degrees + inflation * m / scale) * inflation * m).mean() / channels
            )
            if abs(updated / scale - 1) < 1e-4:
                break
            scale = max(updated, least)
            if updated < least:
                break
        constant = standard_constant(degrees, channels)
        terms = constant - 0.5 * channels * np.log(scale) - 0.5 * (degrees + channels) * np.log1p(m / scale / degrees)
        score = float(terms.sum() - half_det) + 0.5 * spent * np.log(scale / used.scale) - tails_cost(degrees, len(m))
        if score > best[1]:
            best = (replace(scatter, degrees=float(degrees), scale=scale), score)
    return best
