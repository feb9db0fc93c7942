"""A spring in a joint: cables, hoses, rubber boots, tendons."""

import math
from typing import ClassVar, Self

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows, World
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.elements import is_axis
from nfpde.errors import BadEffect


@register
class JointSpring(Effect):
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

    def together(self, values: Array, shares: Array) -> Array:
        """The stiffnesses' sum with its common rest."""
        return self.bent(shares @ self.straightened(values))

    def straightened(self, values: Array) -> Array:
        """Stiffness and torque in the middle of the rests [Nm/rad, Nm]: the torque is linear in these.

        Along soft springs whose rest is far and stiff ones whose rest is near the torque is much the same: in stiffness
        and rest a curved valley.
        """
        middle, _ = self._rests()
        return np.stack([values[..., 0], values[..., 0] * (values[..., 1] - middle)], axis=-1)

    def bent(self, coordinates: Array) -> Array:
        """Stiffness and rest; a torque that no rest within the bounds gives is brought down to one that does."""
        middle, far = self._rests()
        stiffness, torque = coordinates[..., 0], coordinates[..., 1]
        away = np.divide(torque, stiffness, out=np.zeros_like(torque), where=stiffness > 0)
        return np.stack([stiffness, middle + np.clip(away, -far, far)], axis=-1)

    def straight_bounds(self) -> tuple[Array, Array]:
        """Every stiffness, and the torques of the greatest."""
        stiffness, (_, far) = self.parameters[0], self._rests()
        return np.array([stiffness.low, -stiffness.high * far]), np.array([stiffness.high, stiffness.high * far])

    def _rests(self) -> tuple[float, float]:
        """Middle and half width of the rests."""
        rest = self.parameters[1]
        return 0.5 * (rest.low + rest.high), 0.5 * (rest.high - rest.low)

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Pull towards the rest position."""
        stiffness, rest = values[:, 0, None], values[:, 1, None]
        world.qfrc_applied[np.ix_(rows, self.dofs)] += stiffness * (rest - world.qpos[np.ix_(rows, self.qposadr)])
