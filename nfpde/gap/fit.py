"""Least squares in a box: base parameters and effects together, by Levenberg-Marquardt on a black-box simulator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.directions import Directions
from nfpde.gap.jackknife import moves_without
from nfpde.gap.loud import Loudness
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

PART, FEWEST = 1 / 4, 20
"""Many guesses are first compared on this share of the windows, and on so many at least (successive halving: Karnin,
Koren and Somekh, ICML 2013)."""

MANY, GO_ON = 16, 8
"""Times as many guesses as are asked for, from which they are many, and of these as many as go on to all windows."""

_DAMPINGS = np.array([0.1, 10.0])

_KEPT_WORD = 0.5
"""Share of the gain that slopes foretell, by which a step must at least improve for them to be used again."""

_TURNS, _AGREE = 4, 2.0
"""Turns in which steps follow the errors that they tell, at most, and the change of all steps that ends them."""

_BENT = 5.0
"""Nats that the boldest step must have promised beyond what any gained, for a look along the bend of its valley."""

_BACK = 1e-4
"""Share of the damping that counts there: straight across, as what pulls along the valley takes the step back."""

LAST = 1e-2
"""Nats below which a step is not worth taking."""

_ROUGHLY = 1e-3
"""The same as a share of what has been gained, where the slopes need not be those of the place."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted replay.

    xi: free parameters (D,)
    cost: negative log posterior up to a constant [nats], with `scatter`
    scatter: of the residuals, that the cost is counted with
    residuals: of the fit's windows (N, nv, C)
    slopes: of the residuals by each parameter, in shares of its bounds (D, N, nv, C)
    information: in shares of the bounds (D, D)
    fresh: slopes from this parameter on are those of this place; D where none are
    known: whether slopes were ever taken, here or nearby
    """

    replay: Replay
    xi: Array
    cost: float
    scatter: Scatter
    residuals: Array
    slopes: Array
    information: Array
    fresh: int
    known: bool = False

    def some(self, index: NDArray[np.intp]) -> Fit:
        """The same on some of the windows; cost and information stay those of all."""
        return replace(self, residuals=self.residuals[index], slopes=self.slopes[:, index])

    @property
    def standard_errors(self) -> Array:
        """Of the parameters, in their units (D,), by slopes: a jackknife over windows, taken as independent."""
        d = len(self.xi)
        if not d:
            return np.zeros(0)
        slopes = self.scatter.turned(self.slopes)
        moves = moves_without(self.scatter, self.residuals, slopes, np.eye(d) / PRIOR**2)
        turn = self.replay.outward_slopes(self.xi)
        least = 1e-6 * np.linalg.pinv(self.information, hermitian=True)
        variance = ((moves @ turn.T) ** 2).sum(0)
        return np.sqrt(np.maximum(variance, np.einsum("id,de,ie->i", turn, least, turn)))


@dataclass(frozen=True, eq=False)
class Fitter:
    """Fits replays to the same windows.

    windows: what is fitted
    horizons: where it is compared
    noise: what residuals are quietened by, of these windows; None: all windows are alike
    dofs: degrees of freedom that are looked at; None: all. Only these are in residuals then
    channels: of each of them the first so many are looked at; None: all
    force: typical generalized forces (nv,), where contacts are, see `noise_residuals`; else None
    """

    windows: Windows
    horizons: Sequence[int]
    noise: Loudness | Directions | None = None
    dofs: NDArray[np.intp] | None = None
    channels: int | None = None
    force: Array | None = None

    def some(self, index: NDArray[np.intp]) -> Fitter:
        """The same on some of the windows."""
        noise = None if self.noise is None else self.noise.some(index)
        return replace(self, windows=self.windows[index], noise=noise)

    @property
    def part(self) -> NDArray[np.intp] | None:
        """Some of the windows, to compare many guesses on first; None where they are few."""
        total = len(self.windows)
        count = max(math.ceil(PART * total), FEWEST)
        return None if 2 * count > total else np.linspace(0, total - 1, count).round().astype(np.intp)

    def seen(self, residuals: Array) -> Array:
        """Of residuals of all degrees of freedom (..., nv, C) those that are looked at."""
        residuals = residuals if self.dofs is None else residuals[..., self.dofs, :]
        return residuals if self.channels is None else residuals[..., : self.channels]

    def moved(self, replay: Replay) -> Array:
        """By how much the channels change over the horizons, as residuals (N, nv, C)."""
        return self.seen(replay.moved(self.windows, self.horizons))

    def quieten(self, residuals: Array) -> Array:
        """Residuals of these windows (..., N, nv, C) counted by how loud noise is in them."""
        return residuals if self.noise is None else self.noise.quieten(residuals)

    def start(self, replay: Replay, guesses: Array, scatter: Scatter) -> Fit:
        """The best of several guesses (G, D), inside the bounds."""
        u = replay.inward(guesses)
        residuals = self._residuals(replay, u)
        costs = [self._cost(u[i], residuals[i], scatter) for i in range(len(u))]
        best = int(np.argmin(costs))
        d = replay.nfree
        empty = np.zeros((d, *residuals.shape[1:]))
        return Fit(replay, replay.outward(u[best]), costs[best], scatter, residuals[best], empty, np.eye(d), d)

    def best(self, replay: Replay, guesses: Array, scatter: Scatter, count: int, base: Fit | None = None) -> Array:
        """The best of several guesses (G, D), best first.

        Args:
            replay: What is simulated.
            guesses: Free parameters (G, D).
            scatter: What counts.
            count: How many to give back (`count`, D); with a base twice as many: the best as they are, too.
            base: A linearised fit on these windows of a replay with the first parameters alone: they make up for the
                rest of each guess first, as far as slopes foretell.
        """
        if len(guesses) > MANY * count:
            guesses = self._ahead(replay, guesses, scatter, GO_ON * count, base)
        compared = self._compared(replay, guesses, scatter, base)
        return np.concatenate([places[np.argsort(costs, kind="stable")[:count]] for costs, places in compared])

    def _ahead(self, replay: Replay, guesses: Array, by: Scatter, count: int, base: Fit | None) -> Array:
        """Guesses that are among the best so many on a part of the windows; all, where the windows are few."""
        some = self.part
        if some is None:
            return guesses
        compared = self.some(some)._compared(replay, guesses, by, base and base.some(some))
        return guesses[np.unique([np.argsort(costs, kind="stable")[:count] for costs, _ in compared])]

    def _compared(self, replay: Replay, guesses: Array, by: Scatter, base: Fit | None) -> list[tuple[Array, Array]]:
        """Costs of guesses (G,) and their places (G, D): where a base's parameters made up for the rest, and as is."""
        u = replay.inward(guesses)
        residuals = self._residuals(replay, u)
        stay = np.array([self._cost(row, r, by) for row, r in zip(u, residuals, strict=True)])
        if base is None or not len(base.xi):
            return [(stay, guesses)]
        costs = np.array(self._react(u, residuals, base, by))
        return [(costs, replay.outward(u)), (stay, guesses)]

    def _react(self, u: Array, residuals: Array, base: Fit, scatter: Scatter) -> list[float]:
        """Move a base's parameters in u (G, D) to where slopes foretell the least costs, which are returned."""
        k = len(base.xi)
        slopes, white = scatter.turned(base.slopes), scatter.whiten(np.where(np.isfinite(residuals), residuals, 0.0))
        flat, costs = slopes.reshape(k, -1), list[float]()
        for row, there, r in zip(u, white, residuals, strict=True):
            weighted = (slopes * scatter.weights(there)[..., None]).reshape(k, -1)
            matrix = weighted @ flat.T + np.eye(k) / PRIOR**2
            gradient = weighted @ there.ravel() + (row[:k] - 0.5) / PRIOR**2
            moved = np.clip(row[:k] - np.linalg.solve(matrix, gradient), 0.0, 1.0)
            foretold: Array = r + np.tensordot(moved - row[:k], base.slopes, 1)
            row[:k] = moved
            costs.append(self._cost(row, foretold, scatter))
        return costs

    def foretold(self, replay: Replay, xi: Array, residuals: Array, base: Fit, scatter: Scatter) -> Array:
        """Negative log posteriors (G,) [nats] where a base's parameters make up for the rest, or stay: what is less.

        Args:
            replay: What is simulated.
            xi: Free parameters (G, D), those of the base first.
            residuals: There (G, N, nv, C).
            base: A linearised fit on these windows.
            scatter: What counts.
        """
        u = replay.inward(xi)
        stay = np.array([self._cost(row, r, scatter) for row, r in zip(u, residuals, strict=True)])
        if not len(base.xi):
            return stay
        return np.minimum(stay, self._react(u, residuals, base, scatter))

    def residuals_at(self, replay: Replay, xi: Array, force: Array | None = None) -> Array:
        """Residuals (G, N, nv, C) at free parameters (G, D), brought inside the bounds; see `Replay.residuals`."""
        return self._residuals(replay, replay.inward(xi), force)

    def costs(self, replay: Replay, u: Array, scatter: Scatter) -> Array:
        """Negative log posteriors (G,) [nats] at shares of the bounds (G, D)."""
        residuals = self._residuals(replay, u)
        return np.array([self._cost(row, r, scatter) for row, r in zip(u, residuals, strict=True)])

    def rescale(self, fit: Fit, scatter: Scatter) -> Fit:
        """The same place, counted with another scatter."""
        u = fit.replay.inward(fit.xi[None])[0]
        return replace(fit, scatter=scatter, cost=self._cost(u, fit.residuals, scatter))

    def improve(self, fit: Fit, iterations: int, kept: int = 0, last: float = LAST) -> Fit:
        """Up to `iterations` steps; stops when a step promises no more than `last` [nats].

        Slopes are carried along from step to step (Broyden, Math. Comp. 1965), and taken anew where they mislead and
        before they say that nothing is left to gain. Those of the first `kept` parameters are taken from the fit until
        they mislead: an effect that was added hardly changes those of the base. With some kept, the end need not be
        exact.
        """
        d, first = fit.replay.nfree, fit.cost
        damping, steps, renew = 1e-2, 0, d if fit.known else kept
        while steps < iterations and d:
            fit = self.linearise(fit, renew)
            settled = fit.fresh == 0 or kept > 0
            u = fit.replay.inward(fit.xi[None])[0]
            gradient = self.gradient(fit, u)
            trials = [self._trial(fit, u, gradient, damping * factor) for factor in _DAMPINGS]
            promise = float(np.max([-gradient @ (t - u) for t in trials]))
            if promise < max(last, _ROUGHLY * (first - fit.cost) if kept else 0.0):
                if settled:
                    break
                renew = 0
                continue
            residuals = [*self._residuals(fit.replay, np.array(trials))]
            costs = [self._cost(t, r, fit.scatter) for t, r in zip(trials, residuals, strict=True)]
            if fit.cost - min(costs) < _foretold(fit, trials[0] - u, gradient) - _BENT:
                bent = self._along_the_bend(fit, u, trials[0], residuals[0], damping * _BACK)
                trials, residuals = [*trials, bent], [*residuals, *self._residuals(fit.replay, bent[None])]
                costs.append(self._cost(bent, residuals[-1], fit.scatter))
            best = int(np.argmin(costs))
            gain, move = fit.cost - costs[best], trials[best] - u
            if gain <= 0 or not move.any():
                if fit.fresh > 0:
                    renew = 0
                    continue
                damping *= 30.0
                if damping > 1e6:
                    break
                continue
            steps += 1
            foretold = _foretold(fit, move, gradient)
            slopes = _carried(fit, move, residuals[best] - fit.residuals)
            xi = fit.replay.outward(trials[best])
            fit = replace(fit, xi=xi, cost=costs[best], residuals=residuals[best], slopes=slopes, fresh=d)
            damping = max(damping * _DAMPINGS[best % 2] * 0.3, 1e-9)  # along a bend as bold as the step that led there
            renew = d if gain >= _KEPT_WORD * foretold else kept
            if gain < last and settled:
                break
        return fit

    def linearise(self, fit: Fit, kept: int = 0) -> Fit:
        """Slopes and information at the fit's place; the slopes of the first `kept` parameters stay as they are."""
        d = fit.replay.nfree
        anew = slice(kept, max(fit.fresh, kept))
        slopes, fresh = fit.slopes, min(fit.fresh, kept)
        if anew.stop > kept:
            u = fit.replay.inward(fit.xi[None])[0]
            sign = np.where(u > 0.5, -1.0, 1.0)[anew]
            step = sign * _widths(fit.information)[anew]
            moved = self._residuals(fit.replay, u + step[:, None] * np.eye(d)[anew])
            slopes = slopes.copy()
            slopes[anew] = (moved - fit.residuals) / step[:, None, None, None]
            slopes[~np.isfinite(slopes)] = 0.0
        weight = fit.scatter.weights(fit.scatter.whiten(fit.residuals))
        white, size = fit.scatter.turned(slopes), fit.residuals.size
        information = (white * weight[..., None]).reshape(d, size) @ white.reshape(d, size).T + np.eye(d) / PRIOR**2
        return replace(fit, slopes=slopes, information=information, fresh=fresh, known=True)

    def resolved(self, fit: Fit) -> Fit:
        """Slopes and information at the fit's place, all over steps that the errors which they tell ask for.

        What nobody knows the error of is looked at over the widest step. Beside contacts that is no slope: a floor is
        known to a tenth of a millimetre, and does something else a hundred times as far away. Where steps find no end,
        as a narrow one sees nothing of what a wide one tells, those count that tell most.
        """
        turns = list[Fit]()
        for _ in range(_TURNS):
            before = _widths(fit.information)
            fit = self.linearise(replace(fit, fresh=fit.replay.nfree))
            change = np.abs(np.log(_widths(fit.information) / before))
            if (change <= math.log(_AGREE)).all():
                return fit
            turns.append(fit)
        most = np.argmax([np.diag(turn.information) for turn in turns], axis=0)
        slopes = np.stack([turns[turn].slopes[i] for i, turn in enumerate(most)])
        return self.linearise(replace(fit, slopes=slopes, fresh=0))

    def gradient(self, fit: Fit, u: Array) -> Array:
        """Of the cost by shares of the bounds (D,), at the fit's place."""
        white = fit.scatter.whiten(fit.residuals)
        weighted = white * fit.scatter.weights(white)[..., None]
        return fit.scatter.turned(fit.slopes).reshape(len(u), -1) @ weighted.ravel() + (u - 0.5) / PRIOR**2

    def _trial(self, fit: Fit, u: Array, gradient: Array, damping: float) -> Array:
        """A damped Gauss-Newton step that stays in the box: parameters pushed against a bound stay there."""
        held = ((u <= 0) & (gradient > 0)) | ((u >= 1) & (gradient < 0))
        step = np.zeros(len(u))
        while not held.all():
            step = _damped_step(fit.information, gradient, ~held, damping)
            beyond = (u + step < 0) & (u <= 0) | (u + step > 1) & (u >= 1)
            if not (beyond & ~held).any():
                break
            held |= beyond
        return np.clip(u + step, 0.0, 1.0)

    def _along_the_bend(self, fit: Fit, u: Array, trial: Array, there: Array, damping: float) -> Array:
        """A trial (D,) moved to where slopes foretell that its residuals (N, nv, C) are what they were foretold to be.

        Two parameters that do the same together make a valley, which bends: a long step along a straight line ends on
        its side (Transtrum and Sethna, arXiv:1201.5885, with the trial as the second point of the bend).
        """
        missed = there - fit.residuals - np.tensordot(trial - u, fit.slopes, 1)
        white = fit.scatter.turned(np.nan_to_num(missed, nan=0.0, posinf=0.0, neginf=0.0))
        weighted = white * fit.scatter.weights(fit.scatter.whiten(fit.residuals))[..., None]
        pulled = fit.scatter.turned(fit.slopes).reshape(len(u), -1) @ weighted.ravel()
        step = _damped_step(fit.information, pulled, (trial > 0) & (trial < 1), damping)
        return np.clip(trial + step, 0.0, 1.0)

    def _cost(self, u: Array, residuals: Array, scatter: Scatter) -> float:
        return float(-scatter.log_density(residuals).sum() + 0.5 * (((u - 0.5) / PRIOR) ** 2).sum())

    def _residuals(self, replay: Replay, u: Array, force: Array | None = None) -> Array:
        xi = np.array([replay.outward(row) for row in u]).reshape(len(u), -1)
        return self.quieten(self.seen(replay.residuals(xi, self.windows, self.horizons, force)))


def _widths(information: Array) -> Array:
    """Finite-difference steps (D,) in shares of the bounds, by the information (D, D) that is believed."""
    return np.clip(RESOLVED / np.sqrt(np.diag(information)), STEP, WIDEST)


def _damped_step(information: Array, gradient: Array, free: NDArray[np.bool_], damping: float) -> Array:
    """A step (D,) of some parameters against a gradient (D,), its diagonal damped (Marquardt, 1963)."""
    step, some = np.zeros(len(gradient)), np.flatnonzero(free)
    matrix = information[np.ix_(some, some)]
    step[some] = -np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), gradient[some])
    return step


def _foretold(fit: Fit, move: Array, gradient: Array) -> float:
    """What slopes say that a move (D,) gains [nats]."""
    return float(-gradient @ move - 0.5 * move @ fit.information @ move)


def _carried(fit: Fit, move: Array, change: Array) -> Array:
    """Slopes changed as little as explains how a step changed the residuals, parameters in their standard errors."""
    weight = np.diag(fit.information) * move
    missed = np.nan_to_num(change - np.tensordot(move, fit.slopes, 1), nan=0.0, posinf=0.0, neginf=0.0)
    return fit.slopes + (weight / float(weight @ move))[:, None, None, None] * missed
