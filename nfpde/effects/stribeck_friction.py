"""Stribeck friction in a joint: more friction at rest than in motion."""

import math

import numpy as np

from nfpde.effects.effect import Array, Effect, Quantity, Rows, World
from nfpde.effects.registry import register


@register
class StribeckFriction(Effect):
    """Dry friction that falls from `static` at rest to `coulomb` in motion.

    The level is coulomb + (static - coulomb) exp(-(v / speed)^2); MuJoCo's `dof_frictionloss` is set to it before
    every physics step, so that sticking and reversal stay with MuJoCo's own constraint solver.

    Reference: Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models, analysis tools and compensation
    methods for the control of machines with friction, Automatica 1994.
    """

    name = "stribeck_friction"
    kind = "joint"
    quantities = (
        Quantity("coulomb", "Nm", 0.0, math.inf, neutral=0.0),
        Quantity("static", "Nm", 0.0, math.inf, neutral=0.0),
        Quantity("speed", "rad/s", 1e-6, math.inf, neutral=0.1, shape_only=True),
    )
    step_fields = ("dof_frictionloss",)
    sentence = "The joint sticks: it takes more torque to start moving than to keep moving."
    confounders = ("coulomb_friction", "load_friction", "backlash", "dead_zone")

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Set the friction level that belongs to the current speed."""
        coulomb, static, speed = (values[:, i, None] for i in range(3))
        cell = np.ix_(rows, self.dofs)
        fall = np.exp(-((world.qvel[cell] / speed) ** 2))
        world.fields["dof_frictionloss"][cell] += coulomb + (static - coulomb) * fall
