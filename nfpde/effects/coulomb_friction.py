"""Coulomb friction in a joint."""

import math

import mujoco

from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_axis


@register
class CoulombFriction(Effect):
    """Dry friction of constant size against the motion of a joint: MuJoCo's `dof_frictionloss`, added to."""

    name = "coulomb_friction"
    kind = "joint"
    quantities = (Quantity("torque", "Nm", 0.0, math.inf, neutral=0.0),)
    sentence = "The joint is held back by a friction torque that does not depend on its speed."
    confounders = ("stribeck_friction", "load_friction", "viscous_damping", "backlash", "dead_zone")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to three times the typical force of a hinge or slide."""
        return (
            {"torque": (0.0, 3 * float(scales.force[model.jnt_dofadr[element]]))} if is_axis(model, element) else None
        )

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Add the torque to the friction loss of the joint's degrees of freedom."""
        model.dof_frictionloss[self.dofs] += values[0]
