"""Inertias that follow their masses all the way or not at all: what is most often so, tried where fits end between.

Beside contacts the likelihood has pits, and a share between the two may be one: an inertia that is wrong by a few
percent, in which something that is not there makes up for the rest.
"""

from __future__ import annotations

from nfpde.gap.fit import Fit
from nfpde.gap.inertia import follows
from nfpde.gap.trial import LEAST_GAIN, Court


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
            fit = min(fit, court.converged(court.fitter.rescale(there, court.scatter(there))), key=lambda f: f.cost)
    return fit
