"""Fits to one half of the recordings, and what they are worth on the other, which no fit saw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student
from scipy.stats import wilcoxon

from nfpde.effects import Effect
from nfpde.gap.fit import LAST, Fit, Fitter
from nfpde.gap.grain import Encoders
from nfpde.gap.loud import DRAWS, noise_residuals
from nfpde.gap.noise import Scatter, learn_scatter

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

STEPS_OF = 20.0
"""Part of what counts that a step must gain, or it is the last of its turn, where more than chance is needed to count:
one in so many."""

SCREENED, GLANCED = (60, 3 / 8), (20, 1 / 8)
"""Windows that candidates are screened on, and glanced at: at least so many, and this share of all."""

MOST_SCREENED = 24
"""Where there are more candidates, all are glanced at, and the best so many screened."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A refitted replay and its log density on the held-out windows.

    effect: the candidate that was added; None for the base
    fit: base parameters, accepted effects and the candidate together
    density: log density of the held-out windows (held,), by the scatter that these show
    held: residuals of the held-out windows (held, nv, C)
    foretold: log density of the held-out windows (held,), by the scatter of those that it was fitted to
    """

    effect: Effect | None
    fit: Fit
    density: Array
    held: Array
    foretold: Array


@dataclass(frozen=True, eq=False)
class Court:
    """Fits to one half of the recordings and judges on the other.

    block: of every held-out window, its group for standard errors (held,)
    fitter, held: of the windows of either half
    floor: smallest residual believed (nv, C)
    nominal: base parameters of the nominal model
    encoders: of the recordings
    capped: share of the largest residuals that are capped where a gap is measured
    quiet: scatter of the residuals where nothing is missing; None where it is not known yet
    """

    block: NDArray[np.intp]
    fitter: Fitter
    held: Fitter
    floor: Array
    nominal: Array
    encoders: Encoders
    capped: float = 0.0
    quiet: Scatter | None = None

    def screening(self, base: Fit, part: tuple[int, float] = SCREENED) -> tuple[Fitter, Fit]:
        """A part of the windows and the fit on it: to rank candidates takes fewer than to judge them.

        Half of them are spread evenly over all, half are those that the base explains worst: an effect may act in few
        windows.
        """
        count = min(max(part[0], round(part[1] * len(self.fitter.windows))), len(self.fitter.windows))
        some = np.unique(np.linspace(0, len(self.fitter.windows) - 1, count - count // 2).round().astype(int))
        worst = np.argsort(-(base.scatter.whiten(base.residuals) ** 2).sum((1, 2)), kind="stable")
        some = np.sort(np.concatenate([some, worst[~np.isin(worst, some)][: count - len(some)]]))
        return self.fitter.some(some), base.some(some)

    def some(self, count: int) -> Court:
        """The same on so many windows of either half, spread evenly over all, or on all if there are fewer."""
        first, second = (
            np.unique(np.linspace(0, len(half.windows) - 1, count).round().astype(np.intp))
            for half in (self.fitter, self.held)
        )
        return replace(self, block=self.block[second], fitter=self.fitter.some(first), held=self.held.some(second))

    def settle(self, fit: Fit, rounds: int = 2, iterations: int = 4, kept: int = 0, last: float = LAST) -> Fit:
        """Fit, learn the scatter from what is left, and again, until both agree; see `Fitter.improve`."""
        for _ in range(rounds):
            fit = self.fitter.rescale(fit, self.scatter(fit))
            fit = self.fitter.improve(fit, iterations, kept, last)
        return self.fitter.rescale(fit, self.scatter(fit))

    def converged(self, fit: Fit, kept: int = 0, least: float = LEAST_GAIN) -> Fit:
        """Fitted to the end: until a turn gains less than what counts [nats], which is chance unless told otherwise."""
        last = LAST if least <= LEAST_GAIN else least / STEPS_OF
        for _ in range(POLISHED):
            found = self.settle(fit, iterations=6, kept=kept, last=last)
            gain, fit = fit.cost - found.cost, found
            if gain < least:
                break
        return fit

    def scatter(self, fit: Fit) -> Scatter:
        """The scatter of what a fit leaves over."""
        return learn_scatter(fit.residuals, fit.replay.nfree, self.floor)

    def judge(self, effect: Effect | None, fit: Fit) -> Trial:
        """Residuals and log density on the held-out windows.

        Each model is judged by the scatter that it leaves there. One that explains most of what there is foretells a
        small scatter, in which a few windows that show another fault are next to impossible: by that scatter it would
        be worse than a model that explains nothing.
        """
        held = self.held.residuals_at(fit.replay, fit.xi[None])[0]
        density = learn_scatter(held, 0, self.floor).log_density(held)
        return Trial(effect, fit, density, held, fit.scatter.log_density(held))

    def gain(self, better: Trial, base: Trial) -> tuple[float, float, float]:
        """Held-out log density gained per window, its standard error over blocks, and their ratio's p-value."""
        return block_test(better.density - base.density, self.block)

    def contradicted(self, better: Trial, other: Trial) -> bool:
        """Whether both halves together favour a trial that the held-out one speaks against.

        Then neither of the two is what made the recordings, and which of them is nearer to it hangs on the halves.
        """
        behind = float((better.density - other.density).sum())
        return better.fit.cost - other.fit.cost - behind >= LEAST_GAIN


def noise_of(fit: Fit, sigma: Array, half: Fitter, seed: int) -> Array:
    """Residuals that noise of the sensors (2 nv,) alone gives, as a fit's model sees it (draws, N, nv, C)."""
    return half.seen(noise_residuals(fit.replay, fit.xi, half.windows, half.horizons, sigma, seed, DRAWS, half.force))


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


def likelihood_test(gain: Array, block: NDArray[np.intp]) -> float:
    """Bound on the probability that window values (N,) sum to so much by chance, without the block that speaks loudest.

    A model that recordings no fit saw make exp(x) times as likely as the true one has a chance of at most exp(-x)
    (split likelihood ratio: Wasserman, Ramdas and Balakrishnan, PNAS 2020).
    """
    sums = np.bincount(np.unique(block, return_inverse=True)[1], weights=gain)
    return float(np.exp(-max(0.0, sums.sum() - sums.max(initial=0.0))))
