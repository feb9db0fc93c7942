"""Whether noise by itself leaves as much as a model does, now and then.

Beside contacts few windows hold most of what noise does, and of a dozen joints one has more than its share: its lead
over the mean of some draws is as large as that of many a fault. How large such leads get where there is nothing but
noise is known from more draws, counted as the recordings are (Davison, Hinkley, Bootstrap methods and their
application, 1997, section 4.2: Monte Carlo tests).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.bootstrap import no_more_than
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.levels import FLOOR_ERROR
from nfpde.gap.trial import DRAWS, noise_of

Array = NDArray[np.float64]

ROUNDS = 17
"""Rounds of a dozen draws, at most. Where none leaves as much, noise does with a probability of 1 in 205 at most."""

_NOTHING = 1e-300
"""What counts as nothing."""

_SEED = 1000
"""Of the first round: these draws are none of those that the floor is a mean of."""


def by_chance(fit: Fit, sigma: Array, held: Fitter, excess: Callable[[Array], float], least: float) -> bool:
    """Whether noise alone leaves as much as a model does in any draw.

    No more are made after one that does, nor where those to come would have to be unlike the first ones.

    Args:
        fit: The model, as it sees the noise: what pushes models aside for the floor's sake is left away.
        sigma: Noise of the sensors (2 nv,), whose square is taken to be known to `FLOOR_ERROR`.
        held: The windows.
        excess: What is asked of residuals (N, nv, C).
        least: What the model leaves of that.
    """
    plain, logs = replace(held, force=None), list[float]()
    bound = float(np.log(max(least, _NOTHING) / (1.0 + FLOOR_ERROR)))
    for number in range(ROUNDS):
        draws = held.quieten(noise_of(fit, sigma, plain, _SEED + number))
        logs += [float(np.log(max(excess(draw), _NOTHING))) for draw in draws]
        if max(logs) >= bound:
            return True
        if number + 1 < ROUNDS and bound > no_more_than(logs, 0.0, ROUNDS * DRAWS):
            return False
    return False
