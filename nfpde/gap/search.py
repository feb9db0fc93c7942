"""Search where slopes mislead: a dense look over all sizes on few windows, then samples that gather about the best.

What is searched for is the least gap, every channel in units of its own residuals: a likelihood whose scatter was
learned far away need not fall on the way there.
"""

from __future__ import annotations

import cma
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from nfpde.gap.chart import Chart
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.gather import Gathering, spread
from nfpde.gap.noise import Scatter
from nfpde.gap.replay import Replay

Array = NDArray[np.float64]
Columns = NDArray[np.intp]

FEW = 20
"""Windows that a look over all sizes takes: the way is long, and a rough map shows it."""

LOOKS, MOST_LOOKS = 48, 192
"""Values looked at for each parameter that is searched, and at most."""

KEPT = 3
"""Places, apart from each other, that are followed."""

ROUGH, FINE = 2, 5
"""Rounds of samples on few windows, and on all."""

GENERATIONS, OFFSPRING, BEST = 16, 8, 4
"""Generations of samples about a rough guess, samples in each at least, and those of all that are given back."""

PATIENCE, STALLED = 8, 1.0
"""Generations after which samples that have gained less [nats] are given up."""

_BESIDE = 0.2
"""Distance of the first samples of parameters beside the effect that is searched, in the chart's units."""

_SHARE = 0.3
"""Distance of the first samples at most, as a share of the bounds."""

_FINER = 0.25
"""Width of the first fine round as a share of the distance of neighbouring looks."""


def search(
    fitter: Fitter,
    replay: Replay,
    index: int,
    guesses: Array,
    scatter: Scatter,
    seed: int = 0,
    enough: float = np.inf,
) -> Fit:
    """The best values of an effect over all its sizes; other parameters start as in a guess and then move along.

    Args:
        fitter: Of the windows.
        replay: What is simulated.
        index: Which of its effects.
        guesses: Free parameters to start from (G, D).
        scatter: What the cost of the fit is counted with.
        seed: Of the samples.
        enough: Cost [nats], see `spread`, below which a rough place is worth a closer look.
    """
    columns = np.arange(replay.nfree)[replay.columns(index)]
    return _search(fitter, replay, columns, guesses, scatter, np.random.default_rng(seed), enough)


def search_all(fitter: Fitter, fit: Fit, seed: int = 0) -> Fit:
    """The same for all free parameters of a fit together, over their bounds."""
    rng = np.random.default_rng(seed)
    return _search(fitter, fit.replay, np.arange(fit.replay.nfree), fit.xi[None], fit.scatter, rng, np.inf)


def search_about(
    fitter: Fitter, fit: Fit, widths: float | Array, seed: int = 0, generations: int = GENERATIONS
) -> Array:
    """The best free parameters (B, D) of samples that evolve about a guess.

    A linear model of the residuals leads nowhere from where they are but rugged; the covariance of the best samples
    does (CMA-ES: Hansen, Ostermeier, Evolutionary Computation 2001).

    Args:
        fitter: Of the windows.
        fit: The guess.
        widths: Distances of the first samples, in the chart's units, of all parameters or of each (D,).
        seed: Of the samples.
        generations: How many of them.
    """
    replay, chart = fit.replay, Chart(fit.replay)
    widths = np.minimum(widths, _SHARE * (chart.high - chart.low))
    settings = {"CMA_stds": widths, "bounds": [chart.low, chart.high], "seed": seed + 1, "verbose": -9}
    settings["maxstd_boundrange"] = np.inf  # the limit fails where there is one parameter, or all are as wide
    evolution = cma.CMAEvolutionStrategy(chart.inward(fit.xi), 1.0, settings)
    tried, costs = [fit.xi], [spread(fitter.residuals_at(replay, fit.xi[None])[0], fit.scatter.floor)]
    best = [costs[0]]
    for _ in range(generations):
        if len(best) > PATIENCE and best[-1 - PATIENCE] - best[-1] < STALLED:
            break
        at = evolution.ask(max(OFFSPRING, evolution.popsize))
        tried.extend(chart.outward(np.array(at)))
        new = [spread(r, fit.scatter.floor) for r in fitter.residuals_at(replay, np.array(tried[-len(at) :]))]
        evolution.tell(at, new)
        costs += new
        best.append(min(costs))
    return np.array(tried)[np.argsort(costs, kind="stable")[:BEST]]


def _search(
    fitter: Fitter,
    replay: Replay,
    columns: Columns,
    guesses: Array,
    scatter: Scatter,
    rng: np.random.Generator,
    enough: float,
) -> Fit:
    chart, few = Chart(replay), _few(fitter)
    places, widths = _look(few, replay, chart, columns, guesses, scatter.floor, rng)
    rough = []
    for place in places:
        found = Gathering(few, replay, chart, scatter.floor, place, columns)
        found.rounds(ROUGH, widths, rng)
        rough.append(found.best)
    costs = [spread(r, scatter.floor) for r in fitter.residuals_at(replay, np.array(rough))]
    if min(costs) > enough:
        return fitter.start(replay, np.array(rough)[[int(np.argmin(costs))]], scatter)
    every = np.arange(replay.nfree)
    first = np.full(len(every), _BESIDE)
    first[columns] = widths
    found = Gathering(fitter, replay, chart, scatter.floor, rough[int(np.argmin(costs))], every)
    found.rounds(FINE, _FINER * first, rng)
    return fitter.start(replay, found.best[None], scatter)


def _few(fitter: Fitter) -> Fitter:
    return fitter.some(np.unique(np.linspace(0, len(fitter.windows) - 1, FEW).round().astype(int)))


def _look(
    few: Fitter,
    replay: Replay,
    chart: Chart,
    columns: Columns,
    guesses: Array,
    floor: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Values all over the bounds of some parameters: the best places (K, D), and how far apart looks are (k,)."""
    k = len(columns)
    count = min(LOOKS * k, MOST_LOOKS)
    low, span = chart.low[columns], (chart.high - chart.low)[columns]
    costs = [spread(r, floor) for r in few.residuals_at(replay, guesses)]
    at = np.tile(chart.inward(guesses[int(np.argmin(costs))]), (count, 1))
    at[:, columns] = low + span * _even(count, k, rng)
    costs += [spread(r, floor) for r in few.residuals_at(replay, chart.outward(at))]
    at = np.concatenate([chart.inward(guesses), at])
    apart = span / count ** (1 / k)
    chosen: list[int] = []
    for i in np.argsort(costs, kind="stable"):
        if all((np.abs(at[i] - at[j])[columns] > 1.5 * apart).any() for j in chosen):
            chosen.append(int(i))
        if len(chosen) == KEPT:
            break
    return chart.outward(at[chosen]), apart


def all_over(replay: Replay, index: int, xi: Array, count: int) -> Array:
    """Guesses (count, D) with values of an effect all over its bounds beside other parameters (D - P,)."""
    chart, columns = Chart(replay), np.arange(replay.nfree)[replay.columns(index)]
    at = np.zeros((count, replay.nfree))
    low, high = chart.low[columns], chart.high[columns]
    at[:, columns] = low + (high - low) * _even(count, len(columns), np.random.default_rng(0))
    found = chart.outward(at)
    found[:, np.setdiff1d(np.arange(replay.nfree), columns)] = xi
    return found


def _even(count: int, size: int, rng: np.random.Generator) -> Array:
    """Points spread evenly over the unit cube (count, size), shifted at random."""
    if size == 1:
        points = np.arange(count)[:, None] / count
    else:
        points = qmc.Sobol(size, scramble=False).random(1 << (count - 1).bit_length())[:count]
    return (points + rng.random(size)) % 1.0
