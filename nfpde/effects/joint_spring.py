"""A spring in a joint: cables, hoses, rubber boots, tendons."""

import math
from typing import ClassVar, Self

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Bounds, Quantity, Rows, World
from nfpde.effects.lever import Lever
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_axis
from nfpde.errors import BadEffect


@register
class JointSpring(Lever):
    """A torque towards a rest position: stiffness (rest - q).

    It adds to a spring of the model, whose rest position may be another; so it is a force, not `jnt_stiffness`.
    """

    name = "joint_spring"
    kind = "joint"
    quantities = (
        Quantity("stiffness", "Nm/rad", 0.0, math.inf, neutral=0.0),
        Quantity("rest", "rad", -math.inf, math.inf, neutral=0.0, shape_only=True),
    )
    default_bounds: ClassVar[Bounds] = {}
    sentence = "Something pulls the joint towards one position: a cable, a hose, a boot, a tendon."
    confounders = ("gravity_tilt", "payload", "joint_offset", "actuator_bias")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to three times the typical force at the typical distance; rest within three such distances.

        They count from where the joint moves and from where the model has its zero, which may lie far apart.
        """
        if not is_axis(model, element):
            return None
        dof = model.jnt_dofadr[element]
        zero, distance = float(model.qpos0[model.jnt_qposadr[element]]), float(scales.position[dof])
        middle, reach = zero + float(scales.middle[dof]), max(3 * distance, 0.5)
        return {
            "stiffness": (0.0, 3 * float(scales.force[dof]) / distance),
            "rest": (min(zero, middle) - reach, max(zero, middle) + reach),
        }

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: a joint that is no hinge or slide.
        """
        bound = super().bind(model)
        if not all(is_axis(model, int(j)) for j in bound.ids):
            raise BadEffect(f"{self.name} on {self.target!r}: it needs hinges or slides, name the ones you mean")
        return bound

    def screened(self, scales: DataScales) -> Array:
        """Weak and strong, with its rest in the middle and to both sides."""
        stiffness, rest = self.parameters
        middle, reach = 0.5 * (rest.low + rest.high), 0.5 * (rest.high - rest.low)
        return np.array([[k * stiffness.high, middle + r * reach] for k in (0.03, 0.2) for r in (-0.6, 0.0, 0.6)])

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Pull towards the rest position."""
        stiffness, rest = values[:, 0, None], values[:, 1, None]
        world.qfrc_applied[np.ix_(rows, self.dofs)] += stiffness * (rest - world.qpos[np.ix_(rows, self.qposadr)])
