"""Screening: what each candidate effect could explain at most, from a few simulations of it at the base fit.

A score test with finite changes: the change that an effect makes to the residuals is projected on the complement of
what the free parameters could do themselves, and scaled to fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from nfpde.effects import Effect
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.noise import Scatter
from nfpde.gap.replay import Replay
from nfpde.gap.sizes import finer

Array = NDArray[np.float64]

_SIZES = (0.4, 1.0, 2.0, 3.5)

SHARE = 0.25
"""Candidates that could explain less than this share of what the best could are not refitted."""

_MOST_SCALE = 1.5
"""How far beyond a screened magnitude the linear scale may go."""


@dataclass(frozen=True, eq=False)
class Screened:
    """A candidate and what it could explain.

    effect: the candidate
    replay: base effects and the candidate
    values: that were tried (K, P)
    explained: reduction of half the weighted squares by each scatter [nats]
    share: of what the best candidate could explain; by the scatter in which it is largest
    starts: scatters in which it explains something, with values to start a fit from (G, P)
    beside: parameters of the base (D,) beside which another effect does the same; None where none was found
    """

    effect: Effect
    replay: Replay
    values: Array
    explained: tuple[float, ...]
    share: float
    starts: tuple[tuple[Scatter, Array], ...]
    beside: Array | None = None


class _View:
    """Residuals of a base fit as a scatter weighs them, without what the free parameters could do themselves."""

    def __init__(self, fitter: Fitter, base: Fit, scatter: Scatter, *, yields: bool) -> None:
        self.scatter, self._fitter, self._base, self._yields = scatter, fitter, base, yields
        self._white = scatter.whiten(base.residuals)
        self._root = np.sqrt(scatter.weights(self._white))[..., None]
        self._span = span_of(base, scatter, self._root)
        self.residual = self._free((self._white * self._root).ravel())
        self._own = self._cost(base.replay, base.xi[None], base.residuals[None])[0]

    def _cost(self, replay: Replay, xi: Array, there: Array) -> Array:
        if self._yields:
            return self._fitter.foretold(replay, xi, there, self._base, self.scatter)
        return -self.scatter.log_density(there).sum(-1)

    def _free(self, rows: Array) -> Array:
        return rows - (rows @ self._span) @ self._span.T

    def changes(self, there: Array) -> Array:
        """What residuals (K, N, nv, C) of a candidate's values change, (K, n)."""
        return self._free(((self.scatter.whiten(there) - self._white) * self._root).reshape(len(there), -1))

    def gains(self, replay: Replay, xi: Array, there: Array) -> Array:
        """What each of a candidate's values gains as it is [nats], (K,).

        With parameters that yield, each after they made up for the rest: they may have taken its part.
        """
        return self._own - self._cost(replay, xi, there)


def screen(
    fitter: Fitter,
    base: Fit,
    candidates: Sequence[tuple[Effect, Array]],
    replay_with: Callable[[Effect], Replay],
    quiet: Scatter | None = None,
    least: float = 0.0,
    *,
    touches: bool = False,
) -> list[Screened]:
    """Screen candidates at a linearised base fit, best first.

    Args:
        fitter: Of the windows.
        base: The base fit, with slopes.
        candidates: Each with the values to try, (K, P).
        replay_with: Makes the replay of the base and one more effect, its parameters last.
        quiet: What residuals scatter by where nothing is missing. What acts in few windows has given the scatter of
            the base heavy tails, and counts for next to nothing in it.
        least: A scatter by which nothing explains more [nats] ranks by chance, and does not count beside one that
            knows more.
        touches: Whether contacts are there: only small changes are linear, many sizes are tried as they are, and what
            one of them gains counts. What lifts a foot changes nothing, what lowers it as much does; a line through
            one of them foretells the wrong thing of the other.
    """
    views = [_View(fitter, base, s, yields=touches) for s in (base.scatter, quiet) if s is not None]
    found = []
    for effect, values in candidates:
        replay = replay_with(effect)
        every = np.vstack([values, finer(effect, values)]) if touches else values
        xi = _beside(base, every)
        there = fitter.residuals_at(replay, xi)
        judged = [_judge(effect, values, v.residual, v.changes(there[: len(values)])) for v in views]
        if touches:  # what slopes foretell counts as far as it comes true
            foreseen = np.array([j.foreseen for j in judged])
            every, xi = np.vstack([every, foreseen]), np.vstack([xi, _beside(base, foreseen)])
            there = np.concatenate([there, fitter.residuals_at(replay, xi[-len(foreseen) :])])
        gains = [v.gains(replay, xi, there) for v in views]
        judged = [_tried(j, every, g, touches=touches) for j, g in zip(judged, gains, strict=True)]
        found.append((effect, replay, values, judged))
    best = [max((judged[v].explained for *_, judged in found), default=0.0) for v in range(len(views))]
    least = least if max(best) > least else 0.0
    out = []
    for effect, replay, values, judged in found:
        shares = [j.explained / most if most > least else 0.0 for j, most in zip(judged, best, strict=True)]
        every = zip(views, judged, shares, strict=True)
        starts = tuple((v.scatter, j.guesses) for v, j, share in every if share >= SHARE)
        explained = tuple(j.explained for j in judged)
        starts = starts or ((views[0].scatter, judged[0].guesses),)
        out.append(Screened(effect, replay, values, explained, max(shares), starts))
    return sorted(out, key=lambda s: -s.share)


def span_of(base: Fit, scatter: Scatter, root: Array) -> Array:
    """Orthonormal columns of what the free parameters can do to the weighted residuals, (n, D)."""
    columns = (scatter.turned(base.slopes) * root).reshape(len(base.slopes), base.residuals.size).T
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 1e-9 * norms.max(initial=1e-300)]
    if not columns.shape[1]:
        return columns
    left, size, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return left[:, size > 1e-7]


def _beside(base: Fit, values: Array) -> Array:
    """Values of an effect (G, P) beside the parameters of a base fit, (G, D + P)."""
    return np.hstack([np.broadcast_to(base.xi, (len(values), len(base.xi))), values])


@dataclass(frozen=True, eq=False)
class _Judged:
    """What a candidate explains, as slopes foretell.

    explained: reduction of half the weighted squares [nats]
    guesses: values to start from (G, P)
    foreseen: the value that explains so much (P,)
    """

    explained: float
    guesses: Array
    foreseen: Array


def _tried(judged: _Judged, values: Array, gains: Array, *, touches: bool) -> _Judged:
    """The same with what values (G, P) gained as they are (G,) [nats]: beside contacts that alone counts."""
    most = float(gains.max())
    if not touches:
        return replace(judged, explained=max(judged.explained, most))
    return replace(judged, explained=most, guesses=np.vstack([judged.guesses, values[gains.argmax()]]))


def _judge(effect: Effect, values: Array, residual: Array, changes: Array) -> _Judged:
    """Best scaling of one change, and of all together."""
    neutral = np.array([q.neutral for q in effect.quantities])
    low, high = (np.array([getattr(p, side) for p in effect.parameters]) for side in ("low", "high"))
    decisive = [i for i, q in enumerate(effect.quantities) if not q.shape_only]
    both_ways = bool(((low < neutral) & (neutral < high))[decisive].all())
    least = -_MOST_SCALE if both_ways else 0.0
    norms = (changes**2).sum(1)
    along = -changes @ residual
    scale = np.clip(along / np.maximum(norms, 1e-300), least, _MOST_SCALE)
    single = scale * along - 0.5 * scale**2 * norms
    best = int(single.argmax())
    guesses = [*values] if scale[best] > 0 else [*values, neutral - (values[best] - neutral)]
    reachable = bool(((neutral >= low) & (neutral <= high))[decisive].all())  # some are neutral at infinity only
    single_at = len(guesses) + _SIZES.index(1.0)
    if reachable:  # the change is not linear in the size: a few sizes about the best one
        guesses += [neutral + f * scale[best] * (values[best] - neutral) for f in _SIZES]
    explained, mixed = float(single[best]), list[Array]()
    if len(values) > 1 and explained > 0:
        gram = changes @ changes.T
        ridge = 1e-9 * max(float(np.trace(gram)), 1e-300)
        triangle = np.linalg.cholesky(gram + ridge * np.eye(len(gram)))
        answer = lsq_linear(triangle.T, np.linalg.solve(triangle, along), bounds=(least, _MOST_SCALE))
        mix = np.asarray(answer.x)
        together = float(mix @ along - 0.5 * mix @ gram @ mix)
        if together > explained:
            explained = together
            if reachable:
                mixed = [effect.together(values, mix)]
    shape = [i for i, q in enumerate(effect.quantities) if q.shape_only]
    kept = np.array(guesses)
    kept[:, shape] = values[best, shape]
    kept = np.vstack([kept, *mixed])
    kept = np.clip(kept, low, high)
    foreseen = kept[-1] if mixed else kept[single_at] if reachable else np.clip(values[best], low, high)
    return _Judged(explained, kept, foreseen)
