"""Windows where episodes begin: left out, as earlier commands are unknown, unless they show what others do not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.chance import by_chance
from nfpde.gap.fit import Fitter
from nfpde.gap.levels import calm
from nfpde.gap.noise import precision_of
from nfpde.gap.recordings import Recordings, joined
from nfpde.gap.trial import Trial, noise_of

Array = NDArray[np.float64]

WORSE = 2.0
"""Mean squares in windows at the beginning of episodes, in those of the others or of noise, from which they count."""


def begins_otherwise(final: Trial, sigma: Array, every: Recordings, lead: int, capped: float, seed: int) -> bool:
    """Whether what was found without the first `lead` rows of episodes does not hold there.

    What was commanded before an episode is not known, and matters to few effects; but a robot that rests on a floor
    tells little of its height: that is told by the fall before. Falls are loud, and few: what noise does there is asked
    for until it does as much, or is sure not to. The very first row is not asked: robots are put down so that they just
    touch the floor, and whether they do is decided by noise, in what is recorded as in the draws beside it: twice.

    Args:
        final: What was found, on windows of the same length.
        sigma: Noise of the sensors (2 nv,).
        every: Windows, those left out among them.
        lead: Rows.
        capped: Share of the largest squares that are capped.
        seed: Of the draws of noise, which contacts may make larger there than elsewhere.
    """
    windows = joined(every.fit, every.held)
    begins = windows.row < lead
    early, others = (windows[np.flatnonzero(part)] for part in (begins & (windows.row > 0), ~begins))
    if not len(early) or not len(others):
        return False
    replay, xi = final.fit.replay, final.fit.xi

    def fitter(some: Windows) -> Fitter:
        return Fitter(some, every.horizons, channels=every.channels)

    usual = calm(fitter(others).residuals_at(replay, xi[None])[0] ** 2, capped).mean(0)
    usual = usual + precision_of(fitter(windows).moved(replay)) ** 2

    def size(residuals: Array) -> float:
        return float(calm(residuals**2 / usual, capped).mean())

    there = fitter(early)
    shown = size(there.residuals_at(replay, xi[None])[0])
    if shown <= WORSE:
        return False
    given = float(np.mean([size(draw) for draw in noise_of(final.fit, sigma, there, seed)]))
    return shown > WORSE * given and not by_chance(final.fit, sigma, there, size, shown)
