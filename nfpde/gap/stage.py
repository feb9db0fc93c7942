"""Recordings cut to windows of one length, the fit of the parameters alone, and what judges effects on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.chart import evenly
from nfpde.gap.ends import at_ends
from nfpde.gap.erring import misjudged
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.funnel import down_the_funnel
from nfpde.gap.levels import CAPPED, Yardstick, calm, shrink_interval
from nfpde.gap.noise import Scatter, floor_of, learn_scatter, precision_of
from nfpde.gap.quiet import quietened
from nfpde.gap.recordings import Recordings
from nfpde.gap.replay import Replay
from nfpde.gap.sensors import sensor_noise
from nfpde.gap.trial import Court, Trial

Array = NDArray[np.float64]

LOOKS, PITS = 32, 3
"""Values looked at all over the bounds of free parameters, for each of them, and the best of these to fit from: where
contacts are."""


@dataclass(frozen=True, eq=False)
class Stage:
    """What a diagnosis works with on windows of one length.

    recordings: the windows
    nominal: held-out residuals of the nominal model (N, nv, C)
    base: the parameters fitted, without effects
    court: fits and judges
    yardstick: measures the gap
    sigma: noise of the sensors (2 nv,)
    misjudged: what is found of it, as a share, before that is made up for (2 nv,)
    """

    recordings: Recordings
    nominal: Array
    base: Trial
    court: Court
    yardstick: Yardstick
    sigma: Array
    misjudged: Array | float = 1.0

    def at(self, base: Trial) -> Stage:
        """The same windows with another fit of the parameters alone, by which gaps are counted from now on."""
        return replace(self, base=base, yardstick=self.yardstick.beside(base.held))

    def in_noise_of(self, draws: Array) -> Stage:
        """The same windows beside other residuals that noise alone gives (draws, N, nv, C)."""
        own = self.yardstick
        return replace(self, yardstick=Yardstick.of(draws, self.base.held, own.capped, own.precision))

    def shown(self, trial: Trial, *, refitted: bool) -> Trial:
        """A trial of windows of another length on these.

        Args:
            trial: Its free parameters count.
            refitted: Whether they are fitted to these windows too, past bumps, where that leaves less over.
        """
        court, replay = self.court, trial.fit.replay
        fit = court.fitter.start(replay, trial.fit.xi[None], self.base.fit.scatter)
        fit = replace(fit, information=trial.fit.information)  # says over which steps slopes are slopes
        fit = court.fitter.rescale(fit, court.scatter(fit))
        if refitted:
            settled = court.settle(fit)
            if court.capped and replay.effects:
                settled = down_the_funnel(court, court.converged(settled))
            fit = min((fit, settled), key=lambda f: float(self.yardstick.gap(f.residuals).mean()))
        return court.judge(trial.effect, fit)


def first_fit(
    start: Replay,
    recordings: Recordings,
    guesses: Array,
    *,
    capped: bool,
    look: bool = True,
    dofs: NDArray[np.intp] | None = None,
) -> tuple[Trial, Court]:
    """The fit of the parameters alone, and the court that judges effects, before the noise of windows is known.

    Args:
        start: The nominal model with its free parameters.
        recordings: The windows.
        guesses: Free parameters to start from, the nominal ones first (G, D).
        capped: Whether contacts make a few residuals so large that they would outweigh all others.
        look: Whether to look all over the bounds too, where contacts are.
        dofs: Degrees of freedom that are looked at; None: all.
    """
    fitter, held = fitters(recordings, dofs)
    moved = fitter.moved(start)
    first = fitter.residuals_at(start, guesses[:1])[0]
    scatter = learn_scatter(first, 0, floor_of(first, moved))
    fit, share = _improved(fitter, start, guesses, scatter), CAPPED if capped else 0.0
    if capped and look:
        fit = best_of_pits(fitter, fit, guesses)
    court = Court(
        recordings.block, fitter, held, floor_of(fit.residuals, moved), guesses[0], recordings.encoders, share
    )
    fit = court.settle(fit, rounds=1, iterations=5)
    court = replace(court, floor=floor_of(fit.residuals, moved))
    return _judged(court.settle(fit, rounds=1, iterations=5), court, moved)


def fitters(recordings: Recordings, dofs: NDArray[np.intp] | None) -> tuple[Fitter, Fitter]:
    """What fits the windows of the first half, and what judges by those of the other."""
    horizons, channels = recordings.horizons, recordings.channels
    first, second = (
        Fitter(half, horizons, None, dofs, channels, recordings.force) for half in (recordings.fit, recordings.held)
    )
    return first, second


def best_of_pits(fitter: Fitter, fit: Fit, guesses: Array) -> Fit:
    """The best of a fit and of others, from the best of looks all over the bounds and at guesses (G, D).

    What contacts do has pits between the guesses and the truth, from which slopes lead nowhere.
    """
    start = fit.replay
    if not start.nfree:
        return fit
    everywhere = np.concatenate([guesses, evenly(start, LOOKS * start.nfree)])
    best = fitter.best(start, everywhere, fit.scatter, PITS)
    return min((fit, *(_improved(fitter, start, xi[None], fit.scatter) for xi in best)), key=lambda f: f.cost)


def _improved(fitter: Fitter, start: Replay, guesses: Array, scatter: Scatter) -> Fit:
    return fitter.improve(fitter.start(start, guesses, scatter), 6)


def moved_over(base: Trial, court: Court, recordings: Recordings) -> tuple[Trial, Court]:
    """The base fitted to other halves of the recordings, from where it was."""
    fitter, held = fitters(recordings, court.fitter.dofs)
    fit = fitter.start(base.fit.replay, base.fit.xi[None], base.fit.scatter)
    court = replace(court, block=recordings.block, fitter=fitter, held=held)
    return _judged(court.settle(fit), court, fitter.moved(fit.replay))


def gaps(base: Trial, court: Court) -> Array:
    """What a base leaves in every window, those to fit first (N,)."""
    white = base.fit.scatter.whiten(np.concatenate([base.fit.residuals, base.held]))
    return calm(white**2, court.capped).mean((1, 2))


def in_noise(
    base: Trial,
    court: Court,
    recordings: Recordings,
    seed: int,
    known: Fit | None = None,
    *,
    whole: bool = False,
    share: Array | float | None = None,
    look: bool = False,
) -> Stage:
    """Residuals counted in how loud noise is in each window, and the parameters fitted once more.

    Args:
        base: The parameters fitted to residuals as they are.
        court: That judges these.
        recordings: The windows.
        seed: Of the draws of noise.
        known: A model that knows more than the base does: where contacts are, what a model lacks looks like noise.
        whole: Whether noise is followed in all its directions: what that takes grows with the square of the channels.
        share: By how much the noise of the sensors is misjudged, where an earlier stage has found it, see `Stage`.
        look: Whether to look for the parameters all over their bounds, where contacts are, if more than noise is left:
            where all windows count alike, what noise makes of a few hides what most of them say.
    """
    known = base.fit if known is None else known
    sigma = sensor_noise(known.replay, known.xi, recordings.rows, recordings.encoders)
    if share is None:
        share = 1.0
        if court.capped:
            share = misjudged(known.replay, known.xi, recordings.longest, recordings.encoders, sigma, seed)
    sigma = sigma / share
    left = np.concatenate([base.fit.residuals, base.held])
    # a start's velocity that nobody measured errs alike at all horizons
    whole = whole or recordings.positions_alone
    court, noise = quietened(court, base.fit, left, known, sigma, seed, whole=whole)
    fitter, moved = court.fitter, court.fitter.moved(base.fit.replay)
    found = fitter.start(base.fit.replay, base.fit.xi[None], base.fit.scatter)
    # to the end, as candidates are: else any of them, whatever it does, would take the rest of the way for its work
    found = court.converged(fitter.rescale(found, court.scatter(found)))
    precision = precision_of(moved)
    if court.capped and look and _leaves_more(court.judge(None, found), noise, court, precision, seed):
        found = court.converged(best_of_pits(fitter, found, np.vstack([court.nominal, base.fit.xi])))
    if court.capped:
        found = at_ends(court, down_the_funnel(court, found))
    found = fitter.linearise(found)
    base = court.judge(None, found)
    nominal = court.held.residuals_at(found.replay, court.nominal[None])[0]
    yardstick = Yardstick.of(noise, base.held, court.capped, precision)
    return Stage(recordings, nominal, base, court, yardstick, sigma, share)


def _leaves_more(base: Trial, noise: Array, court: Court, precision: Array, seed: int) -> bool:
    """Whether a base surely leaves more of the held-out windows than noise does (draws, N, nv, C)."""
    yardstick = Yardstick.of(noise, base.held, court.capped, precision)
    floor = yardstick.floor.mean((1, 2))
    return shrink_interval(floor, yardstick.gap(base.held), court.block, seed)[2] < 0


def _judged(fit: Fit, court: Court, moved: Array) -> tuple[Trial, Court]:
    """A fit of the parameters as the base, and the court with the floor that it leaves."""
    court = replace(court, floor=floor_of(fit.residuals, moved))
    fit = court.fitter.linearise(court.fitter.rescale(fit, court.scatter(fit)))
    return court.judge(None, fit), court
