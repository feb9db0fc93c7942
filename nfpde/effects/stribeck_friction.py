"""Stribeck friction in a joint: more friction at rest than in motion."""

import math

import mujoco
import numpy as np

from nfpde.effects.bearing import Bearing
from nfpde.effects.effect import Array, Bounds, Quantity, Rows, World
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_axis


@register
class StribeckFriction(Bearing):
    """Dry friction that falls from `static` at rest to `coulomb` in motion.

    The level is coulomb + (static - coulomb) exp(-(v / speed)^2); MuJoCo's `dof_frictionloss` is set to it before
    every physics step, so that sticking and reversal stay with MuJoCo's own constraint solver.

    Reference: Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models, analysis tools and compensation
    methods for the control of machines with friction, Automatica 1994.
    """

    name = "stribeck_friction"
    quantities = (
        Quantity("coulomb", "Nm", 0.0, math.inf, neutral=0.0),
        Quantity("static", "Nm", 0.0, math.inf, neutral=0.0),
        Quantity("speed", "rad/s", 1e-6, math.inf, neutral=0.1, shape_only=True),
    )
    step_fields = ("dof_frictionloss",)
    sentence = "The joint sticks: it takes more torque to start moving than to keep moving."
    confounders = ("coulomb_friction", "load_friction", "backlash", "dead_zone")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Friction up to three times the typical force of a hinge or slide; speeds below its typical speed."""
        if not is_axis(model, element):
            return None
        dof = model.jnt_dofadr[element]
        friction = (0.0, 3 * float(scales.force[dof]))
        speed = float(scales.speed[dof])
        return {"coulomb": friction, "static": friction, "speed": (0.003 * speed, 0.6 * speed)}

    def screened(self, scales: DataScales) -> Array:
        """Static friction alone, and twice the friction at rest, at two speeds each."""
        most, speed = self.parameters[1].high, self.parameters[2].high
        return np.array([[c * most, s * most, v * speed] for c, s in ((0.02, 0.06), (0.1, 0.2)) for v in (0.05, 0.3)])

    def straightened(self, values: Array) -> Array:
        """`coulomb`, the rise from it to `static`, and `speed`: what is searched for never falls towards rest.

        A friction that vanishes at rest would stand in for noise of the speeds, which blurs the sign of slow ones.
        """
        coulomb, static, speed = (values[..., i] for i in range(3))
        return np.stack([coulomb, np.maximum(static - coulomb, 0.0), speed], axis=-1)

    def bent(self, coordinates: Array) -> Array:
        """`static` at least as large as `coulomb`, and inside its bounds."""
        coulomb, rise, speed = (coordinates[..., i] for i in range(3))
        bounds = self.parameters[1]
        return np.stack([coulomb, np.clip(coulomb + rise, bounds.low, bounds.high), speed], axis=-1)

    def straight_bounds(self) -> tuple[Array, Array]:
        """Those of the values, and a rise of up to the largest `static`."""
        coulomb, static, speed = self.parameters
        return np.array([coulomb.low, 0.0, speed.low]), np.array([coulomb.high, static.high, speed.high])

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Set the friction level that belongs to the current speed."""
        coulomb, static, speed = (values[:, i, None] for i in range(3))
        cell = np.ix_(rows, self.dofs)
        fall = np.exp(-((world.qvel[cell] / speed) ** 2))
        world.fields["dof_frictionloss"][cell] += coulomb + (static - coulomb) * fall
