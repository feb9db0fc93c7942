"""Searches without slopes, where contacts make the likelihood a funnel with rough walls.

Slopes see the next bump. Where these are a thousandth of a value wide and some ten nats high, a fit ends in any of them
hundreds of nats above the truth, and what is left over is taken for the work of something else. A population sees over
them.
"""

from __future__ import annotations

from dataclasses import replace

import cma
import numpy as np
from numpy.typing import NDArray

from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.trial import LEAST_GAIN, Court

Array = NDArray[np.float64]

LOOKS = (2.0, 8.0)
"""Distances from a fit's end at which it is asked whether costs rise as slopes over wide steps foretell, in the errors
that these foretell."""

BOLD = 30.0
"""Spread of the first population, in these errors: slopes over bumps foretell too small ones."""

AGREES = 0.5
"""Share of what a better place gains in the half that it was fitted to, by which the other must gain from it, too."""

GENERATIONS, PATIENCE = 24, 4
"""Generations of a search at most, and those without a gain after which it ends."""


def down_the_funnel(court: Court, fit: Fit) -> Fit:
    """The fit, or one that goes on from a better place that a population finds around it.

    Some looks tell whether costs rise around it as slopes foretell. Where they do not, a covariance matrix is adapted
    (CMA-ES: Hansen, arXiv:1604.00772) from there on, on a part of the windows. The best of a hundred places between
    bumps is better by chance, too: the half that no fit saw must agree. A place lower in the funnel is lower in both
    halves; one that is the best of a hundred in one half is as high as any in the other.

    Args:
        court: Fits.
        fit: Fitted to the end.
    """
    if not fit.replay.nfree:
        return fit
    u, rng = fit.replay.inward(fit.xi[None])[0], np.random.default_rng(0)
    few, part = court.screening(fit)
    part = few.rescale(part, fit.scatter)
    wide = few.linearise(replace(part, information=np.eye(len(u)), fresh=len(u)))
    axes = _axes(wide.information)
    if _rises_as_foretold(few, wide, u, axes, rng):
        return fit
    places = _searched(few, part, u, BOLD * axes, rng)
    found = court.converged(court.fitter.start(fit.replay, fit.replay.outward(places), fit.scatter))
    gain = fit.cost - found.cost
    if gain < LEAST_GAIN:
        return fit
    agrees = court.judge(None, found).density.mean() - court.judge(None, fit).density.mean()
    return found if agrees >= AGREES * gain / len(fit.residuals) else fit


def _rises_as_foretold(fitter: Fitter, fit: Fit, u: Array, axes: Array, rng: np.random.Generator) -> bool:
    """Whether the cost rises around a fit's place (D,) as its slopes foretell, to a half or to chance."""
    z = np.concatenate([far * rng.normal(size=(population(len(u)), len(u))) for far in LOOKS])
    aside = np.clip(u + z @ axes.T, 0.0, 1.0)
    rises, step = fitter.costs(fit.replay, aside, fit.scatter) - fit.cost, aside - u
    bent = 0.5 * np.einsum("gi,ij,gj->g", step, fit.information, step)
    foretold = step @ fitter.gradient(fit, u) + bent
    return bool((np.abs(rises - foretold) <= np.maximum(LEAST_GAIN, 0.5 * bent)).all())


def population(count: int) -> int:
    """How many places are looked at together, for so many parameters; what the search takes by itself."""
    return 4 + int(3 * np.log(count))


def _axes(information: Array) -> Array:
    """Axes of the ellipsoid of errors, one in each column (D, D)."""
    values, vectors = np.linalg.eigh(information)
    return vectors / np.sqrt(np.maximum(values, 1.0))


def _searched(fitter: Fitter, fit: Fit, start: Array, axes: Array, rng: np.random.Generator) -> Array:
    """The best place and the middle of the last population (2, D), in shares of the bounds.

    numpy's global generator, from which the library draws if it is let, is left alone.
    """

    def place(z: Array) -> Array:
        return np.clip(start + z @ axes.T, 0.0, 1.0)

    options = {"verbose": -9, "seed": np.nan, "randn": lambda *shape: rng.normal(size=shape)}
    search, costs = cma.CMAEvolutionStrategy(np.zeros(len(start)), 1.0, options), list[float]()
    while len(costs) < GENERATIONS:
        asked = np.array(search.ask())
        there = fitter.costs(fit.replay, place(asked), fit.scatter)
        search.tell(list(asked), there.tolist())
        costs.append(float(there.min()))
        if len(costs) > PATIENCE and min(costs[:-PATIENCE]) - min(costs[-PATIENCE:]) < LEAST_GAIN:
            break
    return place(np.array([search.result.xbest, search.result.xfavorite]))
