"""Faults of a sensor that are smaller than what its encoder rounds away.

A joint that moves is read at every place of an encoder's step, and what rounding adds averages out. A joint that rests
is read at a few readings again and again, each of which errs by its own up to half a step: any fault that moves no
reading farther than that explains what rounding did.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.effects import Effect
from nfpde.effects.effect import overrides
from nfpde.gap.fit import Fit
from nfpde.gap.grain import Encoders

Array = NDArray[np.float64]

_HALF = 0.5 * (1 + 1e-6)
"""Steps by which a reading may be off, a hair's breadth more than half."""


def is_rounding(effect: Effect, fit: Fit, windows: Windows, encoders: Encoders) -> bool:
    """Whether an effect changes only what joints at rest read, nowhere by more than half a step of their encoders.

    Args:
        effect: The last of the fit's.
        fit: Where its values come from.
        windows: States that were recorded.
        encoders: Of the recordings.
    """
    if not overrides(effect, "to_simulated"):
        return False
    model, states = fit.replay.sim.model, windows.state.reshape(-1, windows.state.shape[2])
    values = fit.xi[fit.replay.columns(len(fit.replay.effects) - 1)]
    moved = np.abs(
        effect.bind(model).to_simulated(states, np.broadcast_to(values, (len(states), len(values)))) - states
    )
    allowed = np.zeros(states.shape[1])
    dofs = np.flatnonzero(encoders.resting(model))
    allowed[model.jnt_qposadr[model.dof_jntid[dofs]]] = _HALF * encoders.grain(model)[dofs]
    return bool((moved <= allowed).all())
