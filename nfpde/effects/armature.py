"""Rotor inertia that the model lacks."""

import math

import mujoco
import numpy as np

from nfpde.effects.bearing import Bearing
from nfpde.effects.effect import Array, Bounds, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_axis


@register
class Armature(Bearing):
    """Inertia about a joint in every posture, as of a rotor behind a gear: MuJoCo's `dof_armature`, added to."""

    name = "armature"
    quantities = (Quantity("inertia", "kg m2", 0.0, math.inf, neutral=0.0),)
    sentence = "The joint is slower to accelerate than its links explain: the rotor's inertia, times the gear squared."
    confounders = ("payload", "motor_strength", "actuator_lag")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to three times the inertia that the joint has at the model's reference position."""
        if not is_axis(model, element):
            return None
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        dof = model.jnt_dofadr[element]
        return {"inertia": (0.0, 3 * float(full[dof, dof]))}

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Add to the armature of the joint's degrees of freedom."""
        model.dof_armature[self.dofs] += values[0]
