"""Joint refits of the candidates that screening likes: parameters, accepted effects and the candidate together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.gather import spread
from nfpde.gap.noise import Scatter
from nfpde.gap.reach import reachable, reaches
from nfpde.gap.replay import Replay
from nfpde.gap.screen import SHARE, Screened
from nfpde.gap.search import all_over, search, search_about
from nfpde.gap.trial import GLANCED, LEAST_GAIN, SOUGHT, Court, Trial

Array = NDArray[np.float64]

QUICK = 6
"""Generations of samples for a rough fit where contacts make slopes mislead."""

ABOUT = 0.5
"""Distance of the first samples of an effect's parameters about a guess, in the chart's units."""

GUESSES = 3
"""Guesses of a candidate's values that are left of all after a look at them on `GLANCED` windows."""

LOOKS = 16
"""Values looked at for a guess, for each parameter of an effect."""

HOPEFUL = 0.5
"""Candidates that explain less than this share of what the best does are not fitted to the end."""

FIRST, SECOND = 8, 4
"""Candidates refitted roughly, and to the end."""

RUGGED = 12
"""Candidates refitted roughly where contacts are: screening goes by slopes and is often wrong there."""


def refit(court: Court, base: Fit, screened: Sequence[Screened]) -> list[Trial]:
    """Refit the candidates that screening likes best; most held-out density first.

    Args:
        court: Fits and judges.
        base: A linearised fit without the candidates.
        screened: Candidates, best first.
    """
    refitting, found = Refitting(court, base), list[tuple[float, Screened, Fit]]()
    for s in sorted(_hopeful(screened, RUGGED if court.rugged else FIRST), key=lambda s: s.effect.whole == "contact"):
        fits = refitting.rough(s)
        gain, best = max((refitting.promise(fit), i) for i, fit in enumerate(fits))
        if gain > LEAST_GAIN:
            found.append((gain, s, fits[best]))
    found.sort(key=lambda one: -one[0])
    close = [(s, refitting.closer(fit, hopeful=gain >= HOPEFUL * found[0][0])) for gain, s, fit in found[:SECOND]]
    most = max((base.cost - fit.cost for _, fit in close), default=0.0)
    trials = []
    for s, fit in close:
        if base.cost - fit.cost >= HOPEFUL * most:
            fit = court.converged(fit, kept=len(base.xi))
        trials.append(court.judge(s.effect, court.fitter.rescale(fit, court.scatter(fit))))
    return sorted(trials, key=lambda trial: -trial.density.mean())


def _hopeful(screened: Sequence[Screened], count: int) -> list[Screened]:
    """Those that could explain enough, and what contacts may do: at other sizes that is more than screening can see."""
    enough = [s for s in screened[:count] if s.share >= SHARE]
    return enough + [s for s in screened if s.effect.whole == "contact" and s.change.any() and s not in enough]


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
        self._beside = reaches(self._few, base.replay, base.xi, court.floor) if court.rugged else np.zeros(0)
        self._gap = self._least = spread(self._part.residuals, court.floor)

    def rough(self, screened: Screened) -> list[Fit]:
        """A candidate fitted to a part of the windows from each of its starts, then counted on all windows."""
        found = [self._roughly(screened, by, values) for by, values in screened.starts]
        self._least = min(self._least, *(spread(fit.residuals, self._court.floor) for fit in found))
        return [self._whole(screened, fit) for fit in found]

    def promise(self, fit: Fit) -> float:
        """What a rough fit gains [nats].

        Where contacts are, a base at the bottom of one of many dents has a likelihood that hardly any other place
        comes near: there it is what is left over that counts.
        """
        if not self._court.rugged:
            return self._base.cost - fit.cost
        return spread(self._base.residuals, self._court.floor) - spread(fit.residuals, self._court.floor)

    def closer(self, fit: Fit, *, hopeful: bool) -> Fit:
        """A rough fit improved; where contacts are, by more samples first, if it is hopeful."""
        court, kept = self._court, len(self._base.xi)
        if court.rugged and hopeful:
            some = court.screening(self._base, SOUGHT)[0]
            about = search_about(some, fit, self._widths(fit.replay))
            found = court.best(fit, about)
            fit = court.fitter.rescale(replace(found, slopes=fit.slopes), court.scatter(found))
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
        starts = [np.hstack([np.broadcast_to(xi, (len(values), len(xi))), values]) for xi in (base.xi, straight)]
        guesses = np.concatenate(starts)
        if not court.rugged or not reachable(screened.effect):
            # a threshold does nothing on one side, and all at once on the other; a load far out resembles a heavy one
            guesses = np.concatenate([guesses, all_over(replay, index, base.xi, LOOKS * values.shape[1])])
        if court.rugged:
            if screened.effect.whole == "contact":
                enough = self._gap - SHARE * (self._gap - self._least)
                fit = search(self._some, replay, index, guesses, by, enough=enough)
            else:
                guesses = self._few.best(replay, guesses, by, GUESSES, self._few_part)
                fit = self._sampled(self._few, self._few.start(replay, guesses[:1], by), guesses[1:])
                fit = self._some.start(replay, fit.xi[None], by)
            # parameters may have to go a long way with the effect
            about = search_about(self._few, fit, self._widths(replay), generations=QUICK)
            return self._sampled(self._some, fit, about)
        # an effect whose part the parameters have played can be worse than none until they give it back
        guesses = self._few.best(replay, guesses, by, GUESSES, self._few_part)
        fit = self._some.start(replay, guesses, by)
        fit.slopes[: len(base.xi)] = self._part.slopes
        return self._some.improve(fit, 2, kept=len(base.xi))

    def _widths(self, replay: Replay) -> Array:
        """Distances of the first samples about a guess, in the chart's units (D,)."""
        widths = np.full(replay.nfree, ABOUT)
        widths[: len(self._beside)] = self._beside
        return widths

    def _sampled(self, fitter: Fitter, fit: Fit, places: Array) -> Fit:
        """The best of a fit's place and others (B, D) by what they leave over on a part of the windows."""
        return replace(self._court, fitter=fitter).best(fit, places)

    def _whole(self, screened: Screened, fit: Fit) -> Fit:
        """The same place on all windows."""
        fit = self._court.fitter.start(screened.replay, fit.xi[None], self._base.scatter)
        fit.slopes[: len(self._base.xi)] = self._base.slopes
        return self._court.fitter.rescale(fit, self._court.scatter(fit))
