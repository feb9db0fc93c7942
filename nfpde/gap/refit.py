"""Joint refits of the candidates that screening likes: parameters, accepted effects and the candidate together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.gap.accepted import called
from nfpde.gap.chart import all_over
from nfpde.gap.fit import Fit
from nfpde.gap.funnel import down_the_funnel
from nfpde.gap.noise import Scatter
from nfpde.gap.screen import SHARE, Screened
from nfpde.gap.trial import GLANCED, LEAST_GAIN, Court, Trial

Array = NDArray[np.float64]

GUESSES = 3
"""Guesses of a candidate's values that are left of all after a look at them on `GLANCED` windows."""

LOOKS = 16
"""Values looked at for a guess, for each parameter of an effect."""

THRESHOLD_LOOKS, CLOSER_THRESHOLD_LOOKS, CLOSER_THRESHOLD = 64, 16, (1 / 8, 1 / 64)
"""The same of an effect that acts from a threshold on, then closer and closer about each of the best: beyond what the
recordings reach it has no slope to follow, and where they reach it seldom, a tenth less cuts off what was sound."""

CONTACT_LOOKS, CLOSER_LOOKS, CLOSER = 128, 32, (1 / 16, 1 / 256)
"""The same in all for what contacts do: a floor only a little higher or lower than it is explains nothing. Shares of
the bounds that are looked at then."""

STEPS = (0.3, 0.1)
"""Shares of the way from no effect to where a part of the windows would have it, looked at on all windows."""

HOPEFUL = 0.5
"""Candidates that explain less than this share of what the best does are not fitted to the end."""

PROMISING = 0.8
"""Those that do less than this, fitted to the end, are not sent a population for, see `down_the_funnel`."""

READINGS = 3
"""Readings of one effect that are refitted, at most: those that screening likes best."""

FIRST, SECOND = (8, 14), (4, 6)
"""Candidates refitted roughly, and to the end: in smooth motion, and beside contacts, where slopes foretell little and
a candidate that screening likes less may turn out the best."""


def refit(court: Court, base: Fit, screened: Sequence[Screened], *, touches: bool) -> list[Trial]:
    """Refit the candidates that screening likes best; most held-out density first.

    Args:
        court: Fits and judges.
        base: A linearised fit without the candidates.
        screened: Candidates, best first.
        touches: Whether contacts are there, so that slopes foretell little.
    """
    refitting, found = Refitting(court, base), list[tuple[float, Screened, Fit]]()
    for s in _hopeful(screened, FIRST[touches]):
        fits = refitting.rough(s)
        gain, best = max((base.cost - fit.cost, i) for i, fit in enumerate(fits))
        if gain > LEAST_GAIN:
            found.append((gain, s, fits[best]))
    found.sort(key=lambda one: -one[0])
    first = among_readings([s.effect for _, s, _ in found], SECOND[touches])
    close = [(s, refitting.closer(fit)) for _, s, fit in (found[i] for i in first)]
    close = _improved(close, base, HOPEFUL, lambda fit: court.converged(fit, kept=len(base.xi)))
    if touches:
        close = _improved(close, base, PROMISING, lambda fit: down_the_funnel(court, fit))
    trials = [court.judge(s.effect, court.fitter.rescale(fit, court.scatter(fit))) for s, fit in close]
    return sorted(trials, key=lambda trial: -trial.density.mean())


def _improved(
    close: Sequence[tuple[Screened, Fit]], base: Fit, share: float, improve: Callable[[Fit], Fit]
) -> list[tuple[Screened, Fit]]:
    """Candidates and their fits, improved where they gain this share of what the best one does, else as they are."""
    most = max((base.cost - fit.cost for _, fit in close), default=0.0)
    return [(s, improve(fit) if base.cost - fit.cost >= share * most else fit) for s, fit in close]


def _hopeful(screened: Sequence[Screened], count: int) -> list[Screened]:
    """Those that could explain enough, and what contacts may do: at other sizes that is more than screening can see.

    A floor that is higher than in the model is never touched there within a short window.
    """
    some = [screened[i] for i in among_readings([s.effect for s in screened], count)]
    enough = [s for s in some if s.share >= SHARE]
    return enough + [s for s in screened if s.effect.whole == "contact" and s not in enough]


def among_readings(effects: Sequence[Effect], count: int) -> list[int]:
    """The first so many of some effects, of each `READINGS` at most, in order: no name takes the place of others."""
    taken, named = Counter[tuple[str, str]](), list[int]()
    for i, effect in enumerate(effects):
        taken[called(effect)] += 1
        if taken[called(effect)] <= READINGS:
            named.append(i)
    # readings take places of their own, as many as there are names
    names, kept = set[tuple[str, str]](), list[int]()
    for i in named:
        names.add(called(effects[i]))
        if len(names) > count:
            break
        kept.append(i)
    return kept


class Refitting:
    """Refits candidates beside one base.

    Args:
        court: Fits and judges.
        base: A linearised fit without the candidates.
    """

    def __init__(self, court: Court, base: Fit) -> None:
        self._court, self._base = court, base
        self._few, self._few_part = court.screening(base, GLANCED)
        self._some, self._part = court.screening(base)

    def rough(self, screened: Screened) -> list[Fit]:
        """A candidate fitted to a part of the windows from each of its starts, then counted on all windows."""
        return [self._whole(screened, self._roughly(screened, by, values)) for by, values in screened.starts]

    def closer(self, fit: Fit) -> Fit:
        """A rough fit improved."""
        court, kept = self._court, len(self._base.xi)
        fits = [court.fitter.improve(fit, 2, kept=kept)]
        if court.quiet is not None:  # windows that a scatter with heavy tails gives up count in this one
            fits.append(court.fitter.improve(court.fitter.rescale(fit, court.quiet), 4, kept=kept))
        return min((court.fitter.rescale(f, court.scatter(f)) for f in fits), key=lambda f: f.cost)

    def _roughly(self, screened: Screened, by: Scatter, values: Array) -> Fit:
        """A candidate fitted to a part of the windows, from guesses of its values (G, P), counted with a scatter."""
        court, base, replay = self._court, self._base, screened.replay
        index = len(replay.effects) - 1
        # without the effect the parameters may have been bent far from the truth to stand in for it
        straight = np.concatenate([court.nominal, base.xi[len(court.nominal) :]])
        places = [base.xi, straight] if screened.beside is None else [base.xi, straight, screened.beside]
        starts = [np.hstack([np.broadcast_to(xi, (len(values), len(xi))), values]) for xi in places]
        guesses = np.concatenate(starts)
        # a threshold does nothing on one side, and all at once on the other; a load far out resembles a heavy one
        looks, closer, shares = _looks(screened.effect)
        guesses = np.concatenate([guesses, all_over(replay, index, guesses[0], looks)])
        for share in shares:
            best = self._few.best(replay, guesses, by, GUESSES, self._few_part)
            guesses = np.concatenate([best, *(all_over(replay, index, xi, closer, share) for xi in best)])
        # an effect whose part the parameters have played can be worse than none until they give it back
        guesses = self._few.best(replay, guesses, by, GUESSES, self._few_part)
        fit = self._some.start(replay, guesses, by)
        fit.slopes[: len(base.xi)] = self._part.slopes
        return self._some.improve(fit, 2, kept=len(base.xi))

    def _whole(self, screened: Screened, fit: Fit) -> Fit:
        """The same place on all windows, or one on the way to it: the worst windows may have led too far."""
        guesses = towards(self._base.xi, fit)
        fit = self._court.fitter.start(screened.replay, guesses, self._base.scatter)
        fit.slopes[: len(self._base.xi)] = self._base.slopes
        return self._court.fitter.rescale(fit, self._court.scatter(fit))


def towards(base: Array, fit: Fit) -> Array:
    """A fit's place with its last effect, and `STEPS` of the way there from a base (D,) without it, (G, D + P)."""
    effect, k = fit.replay.effects[-1], len(base)
    start = np.concatenate([base, fit.xi[k:]])
    for i, (quantity, bounds) in enumerate(zip(effect.quantities, effect.parameters, strict=True)):
        if not quantity.shape_only:
            if not bounds.low <= quantity.neutral <= bounds.high:  # no place is half way from no limit
                return fit.xi[None]
            start[k + i] = quantity.neutral
    return start + np.outer((1.0, *STEPS), fit.xi - start)


def _looks(effect: Effect) -> tuple[int, int, tuple[float, ...]]:
    """Values looked at all over an effect's bounds, about each of the best, and how closely."""
    if effect.whole == "contact":
        return CONTACT_LOOKS, CLOSER_LOOKS, CLOSER
    count = len(effect.quantities)
    if effect.threshold:
        return THRESHOLD_LOOKS * count, CLOSER_THRESHOLD_LOOKS * count, CLOSER_THRESHOLD
    return LOOKS * count, 0, ()
