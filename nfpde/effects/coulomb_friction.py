"""Coulomb friction in a joint."""

import math

import mujoco

from nfpde.effects.effect import Array, Effect, Quantity
from nfpde.effects.registry import register


@register
class CoulombFriction(Effect):
    """Dry friction of constant size against the motion of a joint: MuJoCo's `dof_frictionloss`, added to."""

    name = "coulomb_friction"
    kind = "joint"
    quantities = (Quantity("torque", "Nm", 0.0, math.inf, neutral=0.0),)
    sentence = "The joint is held back by a friction torque that does not depend on its speed."
    confounders = ("stribeck_friction", "load_friction", "viscous_damping", "backlash", "dead_zone")

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Add the torque to the friction loss of the joint's degrees of freedom."""
        model.dof_frictionloss[self.dofs] += values[0]
