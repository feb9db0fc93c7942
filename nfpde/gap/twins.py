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
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.refit import GUESSES, LOOKS, among_readings
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
    *,
    touches: bool,
) -> list[Screened]:
    """Candidates that change predictions as an effect does, most alike first, at the size at which they do.

    Args:
        court: That judged it.
        base: A linearised fit without it.
        found: With it, its effect the last.
        candidates: Others, each with values to try, (K, P).
        replay_with: Makes the replay of the base and one more effect, its parameters last.
        touches: Whether contacts have a part in it.
    """
    fitter, part = court.screening(base, GLANCED)
    every, few = _Changes(fitter, part, found), None
    if touches and (some := fitter.part) is not None:
        few = _Changes(fitter.some(some), part.some(some), found)
    out = list[Screened]()
    for effect, values in candidates:
        replay = replay_with(effect)
        if few is not None and few.hopeless(few.looks(replay, values, (1.0,), touches=touches)[1]):
            continue
        guesses, changes = every.looks(replay, values, (1.0, CLOSER), touches=touches)
        alike = every.likeness(changes)
        order = np.argsort(-alike, kind="stable")[:GUESSES]
        share = float(alike[order[0]])
        if share >= ALIKE:
            start = guesses[order][:, replay.columns(len(replay.effects) - 1)]
            explained = (0.5 * share * every.size,)
            out.append(Screened(effect, replay, values, explained, share, ((found.fit.scatter, start),), every.xi))
    out.sort(key=lambda s: -s.share)
    return [out[i] for i in among_readings([s.effect for s in out], MOST_TWINS)]


class _Changes:
    """What candidates change in windows, by the scatter of a trial, without what the parameters could do themselves.

    Args:
        fitter: Of the windows.
        part: The base linearised on them.
        found: The trial, its effect the last.
    """

    def __init__(self, fitter: Fitter, part: Fit, found: Trial) -> None:
        self._fitter, self._scatter, self.xi = fitter, found.fit.scatter, found.fit.xi[: len(part.xi)]
        self._without = fitter.residuals_at(part.replay, self.xi[None])[0]
        within = fitter.residuals_at(found.fit.replay, found.fit.xi[None])[0]
        self._root = np.sqrt(self._scatter.weights(self._scatter.whiten(within)))[..., None]
        self._span = span_of(part, self._scatter, self._root)
        self.wanted = self._of(within[None])[0]
        self.size = max(float(self.wanted @ self.wanted), 1e-300)

    def _of(self, there: Array) -> Array:
        """Of residuals (K, N, nv, C), (K, n)."""
        white = (self._scatter.whiten(there - self._without) * self._root).reshape(len(there), -1)
        rows = np.nan_to_num(white, nan=0.0, posinf=0.0, neginf=0.0)
        return rows - (rows @ self._span) @ self._span.T

    def looks(self, replay: Replay, values: Array, widths: Sequence[float], *, touches: bool) -> tuple[Array, Array]:
        """Free parameters (G, D) with an effect's values and others about the best of them, and changes (G, n).

        Args:
            replay: The effect is its last.
            values: To begin with (K, P).
            widths: Shares of the bounds that are looked at, one after the other, as long as there is hope.
            touches: Whether contacts are there: what friction holds shows nothing of what it does at its size, until
                it is looked for.
        """
        index = len(replay.effects) - 1
        looks = LOOKS * len(replay.effects[index].quantities)
        guesses = np.hstack([np.tile(self.xi, (len(values), 1)), values])
        changes = self._of(self._fitter.residuals_at(replay, guesses))
        for width in widths:
            if (width < 1.0 or not touches) and not self.conceivable(changes):
                break
            more = all_over(replay, index, guesses[int(self.likeness(changes).argmax())], looks, width)
            guesses = np.vstack([guesses, more])
            changes = np.concatenate([changes, self._of(self._fitter.residuals_at(replay, more))])
        return guesses, changes

    def likeness(self, changes: Array) -> Array:
        """Share of the squares of what the trial's effect changes that changes (G, n) make, (G,)."""
        return 1.0 - ((changes - self.wanted) ** 2).sum(1) / self.size

    def conceivable(self, changes: Array) -> bool:
        """Whether mixtures of changes (G, n) make enough of that for closer looks."""
        return share_of_mixtures(changes, self.wanted) >= CONCEIVABLE

    def hopeless(self, changes: Array) -> bool:
        """Whether they make no more than enough and what as many changes (G, n) make of anything by chance."""
        by_chance = min(len(changes) / changes.shape[1], 0.5)
        return share_of_mixtures(changes, self.wanted) < CONCEIVABLE + (1.0 - CONCEIVABLE) * by_chance


def share_of_mixtures(changes: Array, wanted: Array) -> float:
    """Share of the squares of a wanted change (n,) that the best mixture of changes (K, n) makes."""
    norms = np.linalg.norm(changes, axis=1, keepdims=True)
    left, size, _ = np.linalg.svd((changes / np.maximum(norms, 1e-300)).T, full_matrices=False)
    along = left[:, size > 1e-7].T @ wanted
    return float(along @ along) / max(float(wanted @ wanted), 1e-300)
