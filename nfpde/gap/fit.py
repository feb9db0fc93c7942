"""Least squares in a box: base parameters and effects together, by Levenberg-Marquardt on a black-box simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.noise import Scatter
from nfpde.gap.replay import Replay

Array = NDArray[np.float64]

STEP, WIDEST = 1e-4, 0.02
"""Finite-difference steps, as shares of a parameter's bounds: the smallest, and the widest."""

RESOLVED = 0.3
"""Finite-difference step in standard errors of a parameter: what contacts do between is no slope of any use."""

PRIOR = 0.5
"""Standard deviation of a parameter about the middle of its bounds, as a share of their width: weak, and enough to
keep what the recordings say nothing about from wandering."""

_DAMPINGS = np.array([0.1, 10.0])


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted replay.

    xi: free parameters (D,)
    cost: negative log posterior up to a constant [nats], with `scatter`
    scatter: of the residuals, that the cost is counted with
    residuals: of the fit's windows (N, nv, C)
    slopes: of the residuals by each parameter, in shares of its bounds (D, N, nv, C)
    information: in shares of the bounds (D, D)
    """

    replay: Replay
    xi: Array
    cost: float
    scatter: Scatter
    residuals: Array
    slopes: Array
    information: Array

    @property
    def standard_errors(self) -> Array:
        """Of the parameters, in their units (D,): sandwich estimate, windows taken as independent."""
        d = len(self.xi)
        if not d:
            return np.zeros(0)
        white = self.scatter.whiten(self.residuals)
        weight = self.scatter.weights(white)
        columns = np.einsum("dnvc,nv,nvc->nd", _whiten_slopes(self.scatter, self.slopes), weight, white)
        inverse = np.linalg.pinv(self.information, hermitian=True)
        sandwich = inverse @ (columns.T @ columns) @ inverse
        variance = np.maximum(np.diag(sandwich), np.diag(inverse) * 1e-6)
        return np.sqrt(variance) * (self.replay.high - self.replay.low)


@dataclass(frozen=True, eq=False)
class Fitter:
    """Fits replays to the same windows.

    windows: what is fitted
    horizons: where it is compared
    """

    windows: Windows
    horizons: Sequence[int]

    def start(self, replay: Replay, guesses: Array, scatter: Scatter) -> Fit:
        """The best of several guesses (G, D), inside the bounds."""
        u = self._inside(replay, guesses)
        residuals = self._residuals(replay, u)
        costs = [self._cost(u[i], residuals[i], scatter) for i in range(len(u))]
        best = int(np.argmin(costs))
        d = replay.nfree
        empty = np.zeros((d, *residuals.shape[1:]))
        return Fit(replay, self._xi(replay, u[best]), costs[best], scatter, residuals[best], empty, np.eye(d))

    def residuals_at(self, replay: Replay, xi: Array) -> Array:
        """Residuals (G, N, nv, C) at free parameters (G, D), brought inside the bounds."""
        return self._residuals(replay, self._inside(replay, xi))

    def rescale(self, fit: Fit, scatter: Scatter) -> Fit:
        """The same place, counted with another scatter."""
        u = self._inside(fit.replay, fit.xi[None])[0]
        return replace(fit, scatter=scatter, cost=self._cost(u, fit.residuals, scatter))

    def improve(self, fit: Fit, iterations: int, kept: int = 0) -> Fit:
        """Up to `iterations` steps; stops when a step promises less than a hundredth of a nat.

        The slopes of the first `kept` parameters stay as they are: an effect that was added hardly changes those of
        the base, and a step that they spoil is not taken.
        """
        damping = 1e-2
        for _ in range(iterations if fit.replay.nfree else 0):
            fit = self.linearise(fit, kept)
            u = self._inside(fit.replay, fit.xi[None])[0]
            gradient = self._gradient(fit, u)
            trials = [self._trial(fit, u, gradient, damping * factor) for factor in _DAMPINGS]
            promise = float(np.max([-gradient @ (t - u) for t in trials]))
            if promise < 1e-2:
                break
            residuals = self._residuals(fit.replay, np.array(trials))
            costs = [self._cost(t, r, fit.scatter) for t, r in zip(trials, residuals, strict=True)]
            best = int(np.argmin(costs))
            if costs[best] >= fit.cost:
                damping *= 30.0
                if damping > 1e6:
                    break
                continue
            small = fit.cost - costs[best] < 1e-2
            xi = self._xi(fit.replay, trials[best])
            fit = replace(fit, xi=xi, cost=costs[best], residuals=residuals[best])
            damping = max(damping * _DAMPINGS[best] * 0.3, 1e-9)
            if small:
                break
        return fit

    def linearise(self, fit: Fit, kept: int = 0) -> Fit:
        """Slopes and information at the fit's place; the slopes of the first `kept` parameters stay as they are."""
        d = fit.replay.nfree
        u = self._inside(fit.replay, fit.xi[None])[0]
        sign = np.where(u > 0.5, -1.0, 1.0)[kept:]
        slopes = fit.slopes.copy()
        if d > kept:
            step = sign * np.clip(RESOLVED / np.sqrt(np.diag(fit.information)[kept:]), STEP, WIDEST)
            moved = self._residuals(fit.replay, u + step[:, None] * np.eye(d)[kept:])
            slopes[kept:] = (moved - fit.residuals) / step[:, None, None, None]
            slopes[~np.isfinite(slopes)] = 0.0
        weight = fit.scatter.weights(fit.scatter.whiten(fit.residuals))
        white = _whiten_slopes(fit.scatter, slopes)
        information = np.einsum("dnvc,nv,envc->de", white, weight, white, optimize=True) + np.eye(d) / PRIOR**2
        return replace(fit, slopes=slopes, information=information)

    def _gradient(self, fit: Fit, u: Array) -> Array:
        white = fit.scatter.whiten(fit.residuals)
        weighted = white * fit.scatter.weights(white)[..., None]
        return np.einsum("dnvc,nvc->d", _whiten_slopes(fit.scatter, fit.slopes), weighted) + (u - 0.5) / PRIOR**2

    def _trial(self, fit: Fit, u: Array, gradient: Array, damping: float) -> Array:
        """A damped Gauss-Newton step that stays in the box: parameters pushed against a bound stay there."""
        held = ((u <= 0) & (gradient > 0)) | ((u >= 1) & (gradient < 0))
        step = np.zeros(len(u))
        while not held.all():
            free = np.flatnonzero(~held)
            matrix = fit.information[np.ix_(free, free)]
            matrix = matrix + damping * np.diag(np.diag(matrix))
            step[:] = 0.0
            step[free] = -np.linalg.solve(matrix, gradient[free])
            beyond = (u + step < 0) & (u <= 0) | (u + step > 1) & (u >= 1)
            if not (beyond & ~held).any():
                break
            held |= beyond
        return np.clip(u + step, 0.0, 1.0)

    def _cost(self, u: Array, residuals: Array, scatter: Scatter) -> float:
        return float(-scatter.log_density(residuals).sum() + 0.5 * (((u - 0.5) / PRIOR) ** 2).sum())

    def _residuals(self, replay: Replay, u: Array) -> Array:
        return replay.residuals(
            np.array([self._xi(replay, row) for row in u]).reshape(len(u), -1), self.windows, self.horizons
        )

    def _inside(self, replay: Replay, xi: Array) -> Array:
        return np.clip((xi - replay.low) / (replay.high - replay.low), 0.0, 1.0)

    def _xi(self, replay: Replay, u: Array) -> Array:
        return np.clip(replay.low + u * (replay.high - replay.low), replay.low, replay.high)


def _whiten_slopes(scatter: Scatter, slopes: Array) -> Array:
    return np.stack([slopes[:, :, d] @ n.whitener for d, n in enumerate(scatter.noises)], axis=2)
