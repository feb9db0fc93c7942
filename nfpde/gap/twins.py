"""Effects that do the same as one that was found, wherever screening ranked them.

Screening asks what a candidate explains of all that is left, from the model as it is. Where more than one thing is
wrong, or an effect is far larger than what was tried, the cause may rank low, and something that does the same high.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.gap.chart import all_over
from nfpde.gap.fit import Fit
from nfpde.gap.refit import GUESSES, LOOKS
from nfpde.gap.replay import Replay
from nfpde.gap.screen import Screened, span_of
from nfpde.gap.trial import GLANCED, Court, Trial

Array = NDArray[np.float64]

ALIKE = 0.5
"""Share of what an effect changes (squares) that another must be able to change alike to be tried in its place."""

CONCEIVABLE = 0.25
"""The same share of what mixtures of the values that were tried change: those with less are not looked at closely."""

MOST_TWINS = 3
"""Effects tried in the place of one, at most: those most alike."""

CLOSER = 1 / 8
"""Share of the bounds that is looked at once more about each one's best value: what sticks moves at some sizes only."""


def find_twins(
    court: Court,
    base: Fit,
    found: Trial,
    candidates: Sequence[tuple[Effect, Array]],
    replay_with: Callable[[Effect], Replay],
) -> list[Screened]:
    """Candidates that change predictions as an effect does, most alike first, at the size at which they do.

    Args:
        court: That judged it.
        base: A linearised fit without it.
        found: With it, its effect the last.
        candidates: Others, each with values to try, (K, P).
        replay_with: Makes the replay of the base and one more effect, its parameters last.
    """
    fitter, part = court.screening(base, GLANCED)
    scatter, xi = found.fit.scatter, found.fit.xi[: len(base.xi)]
    without = fitter.residuals_at(base.replay, xi[None])[0]
    within = fitter.residuals_at(found.fit.replay, found.fit.xi[None])[0]
    root = np.sqrt(scatter.weights(scatter.whiten(within)))[..., None]
    span = span_of(part, scatter, root)

    def change(there: Array) -> Array:
        white = (scatter.whiten(there - without) * root).reshape(len(there), -1)
        rows = np.nan_to_num(white, nan=0.0, posinf=0.0, neginf=0.0)
        return rows - (rows @ span) @ span.T

    wanted = change(within[None])[0]
    touches = court.capped > 0
    size, out = max(float(wanted @ wanted), 1e-300), list[Screened]()

    def likeness(changes: Array) -> Array:
        return 1.0 - ((changes - wanted) ** 2).sum(1) / size

    for effect, values in candidates:
        replay = replay_with(effect)
        index, looks = len(replay.effects) - 1, LOOKS * len(effect.quantities)
        guesses = np.hstack([np.tile(xi, (len(values), 1)), values])
        changes = change(fitter.residuals_at(replay, guesses))
        for width in (1.0, CLOSER):
            # beside contacts what friction holds shows nothing of what it does at its size, until it is looked for
            if (width < 1.0 or not touches) and share_of_mixtures(changes, wanted) < CONCEIVABLE:
                break
            more = all_over(replay, index, guesses[int(likeness(changes).argmax())], looks, width)
            guesses = np.vstack([guesses, more])
            changes = np.concatenate([changes, change(fitter.residuals_at(replay, more))])
        alike = likeness(changes)
        order = np.argsort(-alike, kind="stable")[:GUESSES]
        share = float(alike[order[0]])
        if share >= ALIKE:
            start = guesses[order][:, replay.columns(index)]
            out.append(Screened(effect, replay, values, (0.5 * share * size,), share, ((scatter, start),), xi))
    return sorted(out, key=lambda s: -s.share)[:MOST_TWINS]


def share_of_mixtures(changes: Array, wanted: Array) -> float:
    """Share of the squares of a wanted change (n,) that the best mixture of changes (K, n) makes."""
    norms = np.linalg.norm(changes, axis=1, keepdims=True)
    left, size, _ = np.linalg.svd((changes / np.maximum(norms, 1e-300)).T, full_matrices=False)
    along = left[:, size > 1e-7].T @ wanted
    return float(along @ along) / max(float(wanted @ wanted), 1e-300)
