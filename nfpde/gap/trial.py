"""Fits to one half of the recordings, and what they are worth on the other, which no fit saw."""

from __future__ import annotations

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
from nfpde.gap.reach import reaches
from nfpde.gap.search import search_about

Array = NDArray[np.float64]

LEVEL = 0.02
"""Probability of accepting an effect where there is none, shared by the candidates that the held-out windows judge.
Those that screening left out have not seen them, and cost nothing."""

APART = 0.025
"""One-sided probability at which two effects count as told apart."""

LEAST_GAIN = 5.0
"""Log density [nats] that a candidate must gain on the windows it is fitted to for a closer look: with dozens of
candidates that much comes by chance, and more is needed where no fit saw the data."""

POLISHED = 4
"""Turns of a fit to the end at most."""

TURNS, EVOLVED = 2, 24
"""Times that samples start anew about a fit, and generations of each: see `Court.evolved`."""

SCREENED = 60
"""Windows that candidates are screened on."""

SOUGHT = 30
"""Windows on which candidates are screened and sought where contacts make slopes mislead."""

GLANCED, MANY = 20, 24
"""Where there are more candidates than `MANY`, all are glanced at on so many windows, and the best `MANY` screened."""


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
    """Fits to one half of the recordings and judges on the other.

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

    def converged(self, fit: Fit, kept: int = 0) -> Fit:
        """Fitted to the end: until a turn gains no more than chance."""
        if self.rugged:
            return self.evolved(fit)
        for _ in range(POLISHED):
            found = self.settle(fit, iterations=6, kept=kept)
            gain, fit = fit.cost - found.cost, found
            if gain < LEAST_GAIN:
                break
        return fit

    def evolved(self, fit: Fit, turns: int = TURNS) -> Fit:
        """Samples that evolve about a fit until nothing is gained, then slopes: for where slopes alone mislead.

        Args:
            fit: The fit.
            turns: How often samples start anew about the best at most, as far out as residuals change noticeably.
        """
        for turn in range(turns if fit.replay.nfree else 0):
            widths = reaches(self.screening(fit, GLANCED)[0], fit.replay, fit.xi, self.floor)
            places = search_about(self.screening(fit)[0], fit, widths, turn, EVOLVED)
            found = self.best(fit, places)
            gain, fit = spread(fit.residuals, self.floor) - spread(found.residuals, self.floor), found
            if gain < LEAST_GAIN:
                break
        return self.settle(self.fitter.rescale(fit, self.scatter(fit)))

    def best(self, fit: Fit, places: Array) -> Fit:
        """The best of a fit's place and others (B, D) by what they leave over."""
        places = np.vstack([fit.xi, places])
        costs = [spread(r, self.floor) for r in self.fitter.residuals_at(fit.replay, places)]
        return self.fitter.start(fit.replay, places[[int(np.argmin(costs))]], fit.scatter)

    def scatter(self, fit: Fit) -> Scatter:
        """The scatter of what a fit leaves over."""
        return learn_scatter(fit.residuals, fit.replay.nfree, self.floor)

    def judge(self, effect: Effect | None, fit: Fit) -> Trial:
        """Residuals and log density on the held-out windows."""
        held = self.held.residuals_at(fit.replay, fit.xi[None])[0]
        return Trial(effect, fit, fit.scatter.log_density(held), held)

    def gain(self, better: Trial, base: Trial) -> tuple[float, float, float]:
        """Held-out log density gained per window, its standard error over blocks, and their ratio's p-value."""
        return block_test(better.density - base.density, self.block)


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
