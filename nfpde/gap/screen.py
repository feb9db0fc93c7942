"""Screening: what each candidate effect could explain at most, from a few simulations of it at the base fit.

A score test with finite changes: the change that an effect makes to the residuals is projected on the complement of
what the free parameters could do themselves, and scaled to fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from nfpde.effects import Effect
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.gather import spread
from nfpde.gap.replay import Replay

Array = NDArray[np.float64]

_SIZES = (0.4, 1.0, 2.0, 3.5)

_MOST_SCALE = 1.5
"""How far beyond a screened magnitude the linear scale may go."""


@dataclass(frozen=True, eq=False)
class Screened:
    """A candidate and what it could explain.

    effect: the candidate
    replay: base effects and the candidate
    explained: reduction of half the weighted squares, in nats
    guesses: values to start a fit from (G, P)
    change: the projected, weighted change that explains most, of unit length (n,)
    """

    effect: Effect
    replay: Replay
    explained: float
    guesses: Array
    change: Array


def screen(
    fitter: Fitter,
    base: Fit,
    candidates: Sequence[tuple[Effect, Array]],
    replay_with: Callable[[Effect], Replay],
    report: Callable[[int], None] = lambda done: None,
) -> list[Screened]:
    """Screen candidates at a linearised base fit, best first.

    Args:
        fitter: Of the windows.
        base: The base fit, with slopes.
        candidates: Each with the values to try, (K, P).
        replay_with: Makes the replay of the base and one more effect, its parameters last.
        report: Called with the number of candidates done.
    """
    white = base.scatter.whiten(base.residuals)
    root = np.sqrt(base.scatter.weights(white))[..., None]
    residual = (white * root).ravel()
    span = _span(base, root)
    residual = residual - span @ (span.T @ residual)
    own = base.scatter.log_density(base.residuals).sum()
    gap = spread(base.residuals, base.scatter.floor)
    found = []
    for done, (effect, values) in enumerate(candidates):
        replay = replay_with(effect)
        xi = np.hstack([np.broadcast_to(base.xi, (len(values), len(base.xi))), values])
        there = replay.residuals(xi, fitter.windows, fitter.horizons)
        changes = (base.scatter.whiten(there) - white) * root
        changes = changes.reshape(len(values), -1)
        changes = changes - (changes @ span) @ span.T
        gain = float((base.scatter.log_density(there).sum(-1) - own).max())
        if effect.whole == "contact":
            gain = max(gain, *(gap - spread(r, base.scatter.floor) for r in there))
        found.append(_judge(effect, replay, values, residual, changes, gain))
        report(done + 1)
    return sorted(found, key=lambda s: -s.explained)


def _span(base: Fit, root: Array) -> Array:
    """Orthonormal columns of what the free parameters can do to the weighted residuals, (n, D)."""
    slopes = [(base.scatter.whiten(s) * root).ravel() for s in base.slopes]
    columns = np.array(slopes).reshape(len(slopes), base.residuals.size).T
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 1e-9 * norms.max(initial=1e-300)]
    if not columns.shape[1]:
        return columns
    left, size, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return left[:, size > 1e-7]


def _judge(effect: Effect, replay: Replay, values: Array, residual: Array, changes: Array, gain: float) -> Screened:
    """Best scaling of one change, and of all together; or what the best value gained as it is, if that is more.

    Contacts open and close: what an effect does there is no multiple of what it does at another size.
    """
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
    reachable = bool(((neutral >= low) & (neutral <= high)).all())  # some are neutral at infinity only
    if reachable:  # the change is not linear in the size: a few sizes about the best one
        guesses += [neutral + f * scale[best] * (values[best] - neutral) for f in _SIZES]
    explained, change = float(single[best]), changes[best]
    if len(values) > 1 and explained > 0:
        gram = changes @ changes.T
        ridge = 1e-9 * max(float(np.trace(gram)), 1e-300)
        triangle = np.linalg.cholesky(gram + ridge * np.eye(len(gram)))
        answer = lsq_linear(triangle.T, np.linalg.solve(triangle, along), bounds=(least, _MOST_SCALE))
        mix = np.asarray(answer.x)
        together = float(mix @ along - 0.5 * mix @ gram @ mix)
        if together > explained:
            explained, change = together, mix @ changes
            if reachable:
                guesses.append(neutral + mix @ (values - neutral))
    shape = [i for i, q in enumerate(effect.quantities) if q.shape_only]
    kept = np.array(guesses)
    kept[:, shape] = values[best, shape]
    margin = 1e-3 * (high - low)
    length = float(np.linalg.norm(change))
    return Screened(
        effect,
        replay,
        max(explained, gain),
        np.clip(kept, low + margin, high - margin),
        change / length if length else change,
    )
