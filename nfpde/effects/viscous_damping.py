"""Viscous damping of a joint."""

import math

import mujoco
import numpy as np

from nfpde.effects.bearing import Bearing
from nfpde.effects.effect import Array, Bounds, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_jointed, joint_dofs


@register
class ViscousDamping(Bearing):
    """A torque against the motion, in proportion to its speed: MuJoCo's `dof_damping`, added to.

    What it takes away is at most all there is, whatever other parameters and effects make of that.
    """

    name = "viscous_damping"
    quantities = (Quantity("damping", "Nms/rad", -math.inf, math.inf, neutral=0.0),)
    sentence = "The joint is held back, or less than modelled, in proportion to its speed: grease, seals, back-EMF."
    confounders = ("coulomb_friction", "torque_speed", "fluid_drag", "servo_gain")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Down to no damping at all, up to six times the typical force at the typical speed."""
        if not is_jointed(model, element):
            return None
        dofs = joint_dofs(model, np.array([element]))
        typical = float((scales.force[dofs] / scales.speed[dofs]).max())
        return {"damping": (-float(model.dof_damping[dofs].min()), 6 * typical)}

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Add to the damping of the joint's degrees of freedom; a negative one would drive the joint."""
        own = model.dof_damping[self.dofs]
        # what the model itself has is left alone, should it be negative
        model.dof_damping[self.dofs] = np.maximum(own + values[0], np.minimum(own, 0.0))
