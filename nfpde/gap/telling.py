"""Whether longer windows tell more of what was found than those on which it was found.

Beside contacts short windows find effects, as the likelihood of long ones is torn where contacts open and close. But a
start that is measured wrong bends every short window, and what an effect does within it is little. Where nothing tears
them, as on wheels or in an arm that touches something now and then, long windows know values several times better, and
tell effects apart that do the same within a few steps.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.certainty import standard_errors
from nfpde.gap.found import Found
from nfpde.gap.select import Selection
from nfpde.gap.stage import Stage
from nfpde.gap.trial import Trial

Array = NDArray[np.float64]

TWICE = 0.5
"""Variance of what was found on longer windows, in that on shorter ones, from which they tell more: errors beside
contacts are known to some tenths, and windows that tell as much tell nothing new."""


def asks_again(selection: Selection, longer: Stage, shown: Trial, found: Found) -> bool:
    """Whether longer windows may say something else of what was found, and tell more of it.

    They may where others do nearly the same, where one effect may make up for another, and where more than noise is
    left of them.

    Args:
        selection: On these windows.
        longer: The windows.
        shown: What was found, fitted to them.
        found: On shorter ones.
    """
    if not found.accepted:
        return False
    doubtful = found.doubtful or not selection.at_floor(shown)
    return doubtful and tells_more(longer, shown, found.near, found.final)


def tells_more(longer: Stage, shown: Trial, near: Stage, found: Trial) -> bool:
    """Whether windows tell more of the values of effects than those on which they were found.

    Every effect has a part in it: the variances count by the geometric mean of their ratios over what decides about its
    size. What rises of the likelihood are worth beside contacts is taken from their roughness, see `standard_errors`.

    Args:
        longer: The windows.
        shown: Parameters and effects, fitted to them.
        near: Those on which the effects were found.
        found: Parameters and effects as they are there.
    """
    ratio = _log_errors(longer, shown) - _log_errors(near, found)
    return len(ratio) > 0 and 2.0 * float(ratio.mean()) < math.log(TWICE)


def _log_errors(stage: Stage, trial: Trial) -> Array:
    """Logarithms of the standard errors of what decides about the size of effects."""
    fit = stage.court.fitter.resolved(trial.fit)
    errors, replay = standard_errors(stage.court, fit), fit.replay
    decisive = [
        at
        for i, effect in enumerate(replay.effects)
        for at, quantity in enumerate(effect.quantities, replay.columns(i).start)
        if not quantity.shape_only
    ]
    return np.log(np.maximum(errors[decisive], 1e-300))
