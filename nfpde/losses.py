"""How large an error is in each channel of a state, before anything has been fitted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.errors import BadDataset
from nfpde.sim import StateSpace

ROUNDING = 1e-9
"""Movements below this share of the largest of their kind are rounding errors."""


def increment_scale(states: StateSpace, windows: Windows) -> NDArray[np.float64]:
    """Root mean square of what each channel changes by over a window, (ndiff,).

    Positions and velocities differ by a factor of 50 to 100 in most robots, and the plain norm of Eq. 9 is one of
    velocities only; errors divided by this scale count alike, whatever the units. A channel that never moves (or by
    rounding errors: less than a billionth of the largest scale of its kind, positions or velocities) takes the
    smallest scale of its kind, so that moving it still costs.

    Raises:
        BadDataset: nothing moves in the recordings.
    """
    change = states.difference(windows.target, windows.start[:, None, :])
    scale = np.sqrt((change**2).mean(axis=(0, 1)))
    npos = states.ndiff - states.nv
    for part in (slice(0, npos), slice(npos, None)):
        moves = scale[part] > ROUNDING * scale[part].max(initial=0.0)
        if moves.any():
            scale[part] = np.where(moves, scale[part], scale[part][moves].min())
    if not scale.any():
        raise BadDataset("nothing moves in these recordings: they say nothing about the parameters")
    return np.where(scale > 0, scale, scale[scale > 0].min())
