"""Trying candidates: joint refits, and what they are worth on recordings that no fit saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student
from scipy.stats import wilcoxon

from nfpde.effects import Effect
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.gather import spread
from nfpde.gap.levels import CAPPED
from nfpde.gap.noise import Scatter, learn_scatter
from nfpde.gap.screen import SHARE, Screened
from nfpde.gap.search import all_over, search, search_about, search_near

Array = NDArray[np.float64]

LEVEL = 0.02
"""Probability of accepting an effect where there is none, shared by the candidates that the held-out windows judge.
Those that screening left out have not seen them, and cost nothing."""

APART = 0.025
"""One-sided probability at which two effects count as told apart."""

LEAST_GAIN = 5.0
"""Log density [nats] that a candidate must gain on the windows it is fitted to for a closer look: with dozens of
candidates that much comes by chance, and more is needed where no fit saw the data."""

SCREENED = 60
"""Windows that candidates are screened on."""

GLANCED, MANY = 20, 24
"""Where there are more candidates than `MANY`, all are glanced at on so many windows, and the best `MANY` screened."""

QUICK = 12
"""Generations of samples for a rough fit where contacts make slopes mislead."""

TURNS, NARROW = 2, 0.1
"""Turns of samples about a hopeful candidate, and their first width, see `Court.gathered`."""

SOUGHT = 30
"""Windows on which hopeful candidates are sought where contacts make slopes mislead."""

GUESSES = 3
"""Guesses of a candidate's values that are left of all after a look at them on `GLANCED` windows."""

LOOKS = 24
"""Values of an effect's parameter, or of two together, that are looked at for a guess where motion is smooth."""

HOPEFUL = 0.5
"""Candidates that explain less than this share of what the best does are not fitted to the end."""

FIRST, SECOND = 8, 4
"""Candidates refitted roughly, and to the end."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A refitted replay and its log density on the held-out windows.

    effect: the candidate that was added; None for the base
    fit: base parameters, accepted effects and the candidate together
    density: log density of the held-out windows (held,)
    held: residuals of the held-out windows (held, nv, C)
    """

    effect: Effect | None
    fit: Fit
    density: Array
    held: Array


@dataclass(frozen=True, eq=False)
class Court:
    """Refits on one half of the recordings and judges on the other.

    block: of every held-out window, its group for standard errors (held,)
    fitter, held: of the windows of either half
    floor: smallest residual believed (nv, C)
    nominal: base parameters of the nominal model
    rugged: whether contacts make the cost so rugged that slopes mislead
    quiet: scatter of the residuals where nothing is missing; None where contacts are
    """

    block: NDArray[np.intp]
    fitter: Fitter
    held: Fitter
    floor: Array
    nominal: Array
    rugged: bool = False
    quiet: Scatter | None = None

    def screening(self, base: Fit, count: int = SCREENED) -> tuple[Fitter, Fit]:
        """A part of the windows and the fit on it: to rank candidates takes fewer than to judge them.

        They are spread evenly over all, and in smooth motion half of them are those that the base explains worst: an
        effect may act in few windows.
        """
        count = min(count, len(self.fitter.windows))
        even = count if self.rugged else count - count // 2
        some = np.unique(np.linspace(0, len(self.fitter.windows) - 1, even).round().astype(int))
        if len(some) < count:
            worst = np.argsort(-(base.scatter.whiten(base.residuals) ** 2).sum((1, 2)), kind="stable")
            some = np.sort(np.concatenate([some, worst[~np.isin(worst, some)][: count - len(some)]]))
        part = replace(base, residuals=base.residuals[some], slopes=base.slopes[:, some])
        return self.fitter.some(some), part

    @property
    def capped(self) -> float:
        """Share of the largest residuals that are capped where a gap is measured."""
        return CAPPED if self.rugged else 0.0

    def settle(self, fit: Fit, rounds: int = 2, iterations: int = 4, kept: int = 0) -> Fit:
        """Fit, learn the scatter from what is left, and again, until both agree; see `Fitter.improve` for `kept`."""
        for _ in range(rounds):
            fit = self.fitter.rescale(fit, self.scatter(fit))
            fit = self.fitter.improve(fit, iterations, kept)
        return self.fitter.rescale(fit, self.scatter(fit))

    def gathered(self, fit: Fit, turns: int, width: float) -> Fit:
        """Samples that gather about a fit, ever closer, until nothing is gained: for where slopes mislead.

        Args:
            fit: The fit.
            turns: How often at most.
            width: Of the first samples, in the chart's units.
        """
        for turn in range(turns):
            found = search_near(self.fitter, fit, turn, width / (1 + turn))
            gain, fit = spread(fit.residuals, self.floor) - spread(found.residuals, self.floor), found
            if gain < LEAST_GAIN:
                break
        return self.settle(self.fitter.rescale(fit, self.scatter(fit)))

    def scatter(self, fit: Fit) -> Scatter:
        """The scatter of what a fit leaves over."""
        return learn_scatter(fit.residuals, fit.replay.nfree, self.floor)

    def judge(self, effect: Effect | None, fit: Fit) -> Trial:
        """Residuals and log density on the held-out windows."""
        held = self.held.residuals_at(fit.replay, fit.xi[None])[0]
        return Trial(effect, fit, fit.scatter.log_density(held), held)

    def refit(self, base: Fit, screened: Sequence[Screened]) -> list[Trial]:
        """Refit the candidates that screening likes best; most held-out density first."""
        if not screened:
            return []
        hopeful = _hopeful(screened)
        few, some, part = self.screening(base, GLANCED)[0], *self.screening(base)
        rough, gap = list[tuple[float, Screened, Fit]](), [spread(part.residuals, self.floor)]
        for s in sorted(hopeful, key=lambda s: s.effect.whole == "contact"):
            enough = gap[0] - SHARE * (gap[0] - min(gap))
            found = [self._rough(few, some, base, replace(part, scatter=by), s, at, enough) for by, at in s.starts]
            gap += [spread(fit.residuals, self.floor) for fit in found]
            full = [self._whole(base, s, fit) for fit in found]
            gain, best = max(((self._promise(base, fit), i) for i, fit in enumerate(full)), default=(0.0, 0))
            if gain > LEAST_GAIN:
                rough.append((gain, s, full[best]))
        rough.sort(key=lambda found: -found[0])
        close = [(s, self._closer(base, fit, gain >= HOPEFUL * rough[0][0])) for gain, s, fit in rough[:SECOND]]
        most = max((base.cost - fit.cost for _, fit in close), default=0.0)
        trials = []
        for s, fit in close:
            if base.cost - fit.cost >= HOPEFUL * most:
                fit = self.gathered(fit, TURNS, NARROW) if self.rugged else self.settle(fit, kept=len(base.xi))
            trials.append(self.judge(s.effect, self.fitter.rescale(fit, self.scatter(fit))))
        return sorted(trials, key=lambda trial: -trial.density.mean())

    def _rough(
        self, few: Fitter, some: Fitter, base: Fit, part: Fit, screened: Screened, guesses: Array, enough: float
    ) -> Fit:
        """A candidate fitted to a part of the windows, from guesses of its values (G, P)."""
        replay, index = screened.replay, len(screened.replay.effects) - 1
        # without the effect the parameters may have been bent far from the truth to stand in for it
        straight = np.concatenate([self.nominal, base.xi[len(self.nominal) :]])
        starts = [np.hstack([np.broadcast_to(xi, (len(guesses), len(xi))), guesses]) for xi in (base.xi, straight)]
        guesses = np.concatenate(starts)
        if self.rugged:
            if screened.effect.whole == "contact":
                fit = search(some, replay, index, guesses, part.scatter, enough=enough)
            else:
                fit = some.start(replay, few.best(replay, guesses, part.scatter, 1), part.scatter)
            # parameters may have to go a long way with the effect
            return self._sampled(some, fit, search_about(few, fit, index, generations=QUICK))
        if len(guesses[0]) - len(base.xi) <= 2:  # a threshold does nothing on one side, and all at once on the other
            guesses = np.concatenate([guesses, all_over(replay, index, base.xi, LOOKS)])
        fit = some.start(replay, few.best(replay, guesses, part.scatter, GUESSES), part.scatter)
        fit.slopes[: len(base.xi)] = part.slopes
        return some.improve(fit, 2, kept=len(base.xi))

    def _sampled(self, fitter: Fitter, fit: Fit, places: Array) -> Fit:
        """The best of a fit's place and others (B, D)."""
        places = np.vstack([fit.xi, places])
        costs = [spread(r, self.floor) for r in fitter.residuals_at(fit.replay, places)]
        return fitter.start(fit.replay, places[[int(np.argmin(costs))]], fit.scatter)

    def _whole(self, base: Fit, screened: Screened, fit: Fit) -> Fit:
        """The same on all windows."""
        fit = self.fitter.start(screened.replay, fit.xi[None], base.scatter)
        fit.slopes[: len(base.xi)] = base.slopes
        return self.fitter.rescale(fit, self.scatter(fit))

    def _promise(self, base: Fit, fit: Fit) -> float:
        """What a rough fit gains [nats].

        Where contacts are, a base at the bottom of one of many dents has a likelihood that hardly any other place
        comes near: there it is what is left over that counts.
        """
        if not self.rugged:
            return base.cost - fit.cost
        return spread(base.residuals, self.floor) - spread(fit.residuals, self.floor)

    def _closer(self, base: Fit, fit: Fit, hopeful: bool) -> Fit:
        """A rough fit improved; where contacts are, by more samples first, if it is hopeful."""
        if self.rugged and hopeful:
            some = self.screening(base, SOUGHT)[0]
            found = self._sampled(self.fitter, fit, search_about(some, fit, len(fit.replay.effects) - 1))
            fit = self.fitter.rescale(replace(found, slopes=fit.slopes), self.scatter(found))
        fits = [self.fitter.improve(fit, 2, kept=len(base.xi))]
        if self.quiet is not None:  # windows that a scatter with heavy tails gives up count in this one
            loud = self.fitter.improve(self.fitter.rescale(fit, self.quiet), 4, kept=len(base.xi))
            fits.append(self.fitter.rescale(loud, self.scatter(loud)))
        return min(fits, key=lambda f: self.fitter.rescale(f, self.scatter(f)).cost)

    def gain(self, better: Trial, base: Trial) -> tuple[float, float, float]:
        """Held-out log density gained per window, its standard error over blocks, and their ratio's p-value."""
        return block_test(better.density - base.density, self.block)


def _hopeful(screened: Sequence[Screened]) -> list[Screened]:
    """Those that could explain enough, and what contacts may do: at other sizes that is more than screening can see."""
    enough = [s for s in screened[:FIRST] if s.share >= SHARE]
    return enough + [s for s in screened if s.effect.whole == "contact" and s.change.any() and s not in enough]


def block_test(gain: Array, block: NDArray[np.intp]) -> tuple[float, float, float]:
    """Whether window values (N,) are positive: mean over blocks, its standard error, one-sided p-value.

    The p-value is twice the smaller of Student's and Wilcoxon's signed-rank test. An effect that shows in few windows,
    but strongly, has a mean with a large error and still gains in nearly every block; one that shows everywhere alike
    is plain to both.
    """
    means = np.array([gain[block == b].mean() for b in np.unique(block)])
    mean = float(means.mean())
    if len(means) < 2 or not means.any():
        return mean, float("inf"), 1.0
    error = float(means.std(ddof=1) / np.sqrt(len(means)))
    by_mean = float(student.sf(mean / error, len(means) - 1)) if error > 0 else 0.0 if mean > 0 else 1.0
    by_rank = float(np.asarray(wilcoxon(means, alternative="greater"))[1])
    return mean, error, min(1.0, 2 * min(by_mean, by_rank))
