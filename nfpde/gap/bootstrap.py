"""What a candidate gains where there is nothing but noise: a parametric bootstrap.

Beside contacts noise does not average out. A foot that is measured too low presses, one that is measured as much too
high does nothing: errors of the starts push on average, and a floor's height or softness that makes up for it foretells
windows that no fit saw better than the right one does. How much that is worth is found by fitting the candidate to
windows that the model without it has gone through by itself, and the sensors' noise blurred (Efron, Tibshirani, An
introduction to the bootstrap, 1993, chapter 6), and counting them as recordings are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from nfpde.dataset import Windows
from nfpde.gap.directions import Directions
from nfpde.gap.fit import Fit
from nfpde.gap.natural import measured, natural
from nfpde.gap.noise import Scatter, floor_of
from nfpde.gap.quiet import quietened
from nfpde.gap.trial import LEAST_GAIN, Court, Trial

Array = NDArray[np.float64]

DRAWS = 10
"""Draws of the noise of all windows: one in three may give what two do not, where contacts multiply noise. Few effects
live to see them all."""

FIRST, STILL = 3, 0.05
"""Draws after which no more are made of a candidate if one of those still to come would reach what it gained with no
more than this chance (prediction intervals of a normal distribution: Hahn, Meeker, Statistical intervals, 1991,
chapter 4). All draws together rule out one in eleven."""

HIDDEN = LEAST_GAIN / 12**0.5
"""Standard deviation [nats] that draws have at least: what gains less than `LEAST_GAIN` counts as nothing, and may be
anything below that."""

SHARES = (1.0, 0.3, 0.1, 0.01)
"""Of what a candidate was fitted to be, from which it is fitted to noise."""

FEWEST, PLAIN = 80, 20 * LEAST_GAIN
"""Noise is asked on a part of the windows where a candidate must gain so much on them [nats]: what noise gives there by
chance is far below that. It is at least so many of each half, twice as many, four times ..."""

EXACT = 0.05
"""Share of what a candidate must gain, to which it is fitted to a draw: it is to be known whether noise gives as much,
not how much it gives."""


class NoiseAlone:
    """Windows as a model makes them, noise on their states, and what candidates gain there.

    Args:
        court: Fits and judges.
        current: The model, without any of the candidates.
        sigma: Noise of the sensors (2 nv,).
        seed: Of the draws.
    """

    def __init__(self, court: Court, current: Trial, sigma: Array, seed: int = 0) -> None:
        self._court, self._current, self._sigma = court, current, sigma
        self._seed = seed
        self._made: list[tuple[Court, Trial]] = []
        self._gains: dict[tuple[Trial, int], float] = {}
        self._parts: dict[int, NoiseAlone] = {}

    def gives(self, trial: Trial, enough: float) -> bool:
        """Whether a candidate gains as much held-out log density per window [nats] in any of the draws.

        No further draw is fitted after one that does, nor where the first ones give next to nothing of it. Where much
        is to be gained, a part of many windows is enough.

        Args:
            trial: The candidate beside the model, where both were fitted to the recordings.
            enough: What it must gain.
        """
        part = self._part(enough)
        if part is not self:
            return part.gives(trial, enough)
        given = list[float]()
        least = HIDDEN / len(self._court.held.windows)
        for draw in range(DRAWS):
            given.append(max(self.gain(trial, draw, enough), 0.0))
            if given[-1] >= enough:
                return True
            if FIRST <= len(given) < DRAWS and enough > no_more_than(given, least):
                return False
        return False

    def gain(self, trial: Trial, draw: int, enough: float = 0.0) -> float:
        """Held-out log density per window [nats] that a candidate gains in a draw of the noise, to a part of `enough`.

        Nothing, if it does not fit its own half so much better that it would have been looked at. The likelihood has
        pits: the model without it goes on from where it leads, and it starts from where that one is, so that neither
        is credited for what the other had not found.
        """
        if (trial, draw) not in self._gains:
            least = max(LEAST_GAIN, EXACT * enough * len(self._court.fitter.windows))
            court, base = self._draw(draw, least)
            scatter = base.fit.scatter
            found = _refitted(court, trial, _between(trial, (trial.fit.xi, base.fit.xi)), scatter, least)
            led = found.fit.xi[None, : len(base.fit.xi)]
            bases = [base, _refitted(court, base, led, scatter, least)] if led.size else [base]
            best = min(bases, key=lambda t: t.fit.cost)
            better = best.fit.cost - found.fit.cost >= LEAST_GAIN
            self._gains[trial, draw] = court.gain(found, best)[0] if better else 0.0
        return self._gains[trial, draw]

    def _part(self, enough: float) -> NoiseAlone:
        """The same on as many windows as tell whether so much is gained on each [nats]; on all if half are too few."""
        count, windows = FEWEST, len(self._court.held.windows)
        while count * enough < PLAIN and 2 * count <= windows:
            count *= 2
        if 2 * count > windows:
            return self
        if count not in self._parts:
            self._parts[count] = NoiseAlone(self._court.some(count), self._current, self._sigma, self._seed)
        return self._parts[count]

    @cached_property
    def _truths(self) -> list[Windows]:
        """The windows of both halves as the model goes through them."""
        fit, halves = self._current.fit, (self._court.fitter, self._court.held)
        return [natural(fit.replay, fit.xi, half.windows) for half in halves]

    def _draw(self, draw: int, least: float = LEAST_GAIN) -> tuple[Court, Trial]:
        """The court over windows of a draw, and the model fitted to them, as exactly as was asked first.

        What it had still to gain, a candidate gains too, and the model again that goes on from there.
        """
        while len(self._made) <= draw:
            rng, current = np.random.default_rng([self._seed, len(self._made)]), self._current
            recorded, encoders = self._court.fitter.windows, self._court.encoders
            made = [measured(current.fit.replay, truth, self._sigma, recorded, encoders, rng) for truth in self._truths]
            there = judging(self._court, current.fit, made, self._sigma, self._seed)
            self._made.append((there, _refitted(there, current, current.fit.xi[None], current.fit.scatter, least)))
        return self._made[draw]


def no_more_than(given: Sequence[float], least: float, total: int = DRAWS) -> float:
    """What none of the draws still to come gives, but for a chance of `STILL`, where some were given.

    Args:
        given: By the draws so far.
        least: Standard deviation that they have at least.
        total: Draws in all.
    """
    count = len(given)
    quantile = float(student.isf(STILL / (total - count), count - 1))
    return float(np.mean(given) + quantile * np.sqrt(1.0 + 1.0 / count) * max(np.std(given, ddof=1), least))


def judging(court: Court, fit: Fit, halves: Sequence[Windows], sigma: Array, seed: int) -> Court:
    """A court over other windows of both halves, those to fit first, that counts them as one counts its own.

    Args:
        court: That counts its own.
        fit: A model that knows what noise does.
        halves: The windows.
        sigma: Noise of the sensors (2 nv,).
        seed: Of its draws.
    """
    fitter, held = (replace(court.fitter, windows=half, noise=None) for half in halves)
    left = [half.residuals_at(fit.replay, fit.xi[None])[0] for half in (fitter, held)]
    floor = floor_of(left[0], fitter.moved(fit.replay))
    plain = replace(court, fitter=fitter, held=held, floor=floor)
    whole = isinstance(court.fitter.noise, Directions)
    return quietened(plain, fit, np.concatenate(left), fit, sigma, seed, whole=whole)[0]


def _refitted(court: Court, trial: Trial, guesses: Array, scatter: Scatter, least: float) -> Trial:
    """Fitted to a court's windows from the best of several guesses (G, D), until a turn gains less than so much."""
    fit = court.fitter.start(trial.fit.replay, guesses, scatter)
    return court.judge(trial.effect, court.converged(fit, least=least))


def _between(trial: Trial, places: Sequence[Array]) -> Array:
    """Free parameters of places with the last effect as it is, and with less and less of it, (G, D).

    Args:
        trial: With the effect last.
        places: Whose parameters count beside it, with the effect or without; all of them from the first on.
    """
    xi, replay = trial.fit.xi, trial.fit.replay
    columns, effect = replay.columns(len(replay.effects) - 1), replay.effects[-1]
    neutral = np.array([q.neutral for q in effect.quantities])
    within = [p.low <= q.neutral <= p.high for q, p in zip(effect.quantities, effect.parameters, strict=True)]
    # no value is half of no limit
    sizes = neutral + np.outer(SHARES, xi[columns] - neutral) if all(within) else xi[None, columns]
    return np.array([[*place[: columns.start], *size] for place in places for size in sizes])
