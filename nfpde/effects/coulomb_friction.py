"""Coulomb friction in a joint."""

import math

import mujoco
import numpy as np

from nfpde.effects.bearing import Bearing
from nfpde.effects.effect import Array, Bounds, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_jointed, joint_dofs


@register
class CoulombFriction(Bearing):
    """Dry friction of constant size against the motion of a joint: MuJoCo's `dof_frictionloss`, added to."""

    name = "coulomb_friction"
    quantities = (Quantity("torque", "Nm", 0.0, math.inf, neutral=0.0),)
    sentence = "The joint is held back by a friction torque that does not depend on its speed."
    confounders = ("stribeck_friction", "load_friction", "viscous_damping", "backlash", "dead_zone")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to three times the typical force of a ball, hinge or slide; of a ball, about each of its axes."""
        if not is_jointed(model, element):
            return None
        return {"torque": (0.0, 3 * float(scales.force[joint_dofs(model, np.array([element]))].max()))}

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Add the torque to the friction loss of the joint's degrees of freedom."""
        model.dof_frictionloss[self.dofs] += values[0]
