"""Inertias that follow their masses all the way or not at all: what is most often so, tried where fits end between.

Beside contacts the likelihood has pits, and a share between the two may be one: an inertia that is wrong by a few
percent, in which something that is not there makes up for the rest.
"""

from __future__ import annotations

from dataclasses import replace

from nfpde.gap.fit import Fit
from nfpde.gap.inertia import follows
from nfpde.gap.trial import LEAST_GAIN, Court

FIRST = 4
"""Steps from an end by the slopes of the fit, before it is known whether the way leads anywhere else."""

FAR_FROM = 0.1
"""Share of what these steps gained by which an end may still be worse than the fit, and go on."""


def at_ends(court: Court, fit: Fit) -> Fit:
    """The fit, or one that goes on from either end of such a share, where that is better.

    Args:
        court: Fits.
        fit: Fitted to the end.
    """
    for index, parameter in enumerate(fit.replay.parameters):
        if not follows(parameter):
            continue
        for end in (parameter.low, parameter.high):
            if fit.xi[index] == end:  # and went on from there already
                continue
            xi = fit.xi.copy()
            xi[index] = end
            there = court.fitter.start(fit.replay, xi[None], fit.scatter)
            if 0 <= there.cost - fit.cost < LEAST_GAIN:  # recordings in which it hardly turns say nothing of it
                continue
            nearer = court.fitter.improve(replace(there, slopes=fit.slopes, known=True), FIRST, kept=len(xi))
            if _leads_elsewhere(fit, there, nearer):
                found = court.converged(court.fitter.rescale(nearer, court.scatter(nearer)))
                fit = min(fit, found, key=lambda f: f.cost)
    return fit


def _leads_elsewhere(fit: Fit, there: Fit, nearer: Fit) -> bool:
    """Whether first steps from an end are on their way neither back to the fit nor to what is worse."""
    if nearer.cost - fit.cost > max(LEAST_GAIN, FAR_FROM * (there.cost - nearer.cost)):
        return False
    apart = fit.replay.inward(nearer.xi[None])[0] - fit.replay.inward(fit.xi[None])[0]
    alike = abs(nearer.cost - fit.cost) < LEAST_GAIN
    return not (alike and 0.5 * float(apart @ fit.information @ apart) < LEAST_GAIN)
