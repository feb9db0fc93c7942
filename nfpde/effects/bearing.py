"""Effects in the bearings of joints, which free joints do not have."""

from __future__ import annotations

from typing import Self

import mujoco

from nfpde.effects.effect import Effect
from nfpde.elements import is_jointed, joint_dofs, joint_qpos
from nfpde.errors import BadEffect


class Bearing(Effect):
    """An effect of the bearing or the drive of a ball, hinge or slide; of a ball, about each of its axes.

    A free joint only says where a body is: one number in kg and kg m2, or in N and Nm, would hold it by the air. With
    target "*" it is left out.
    """

    kind = "joint"

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: a free joint, or a model that has no others.
        """
        bound = super().bind(model)
        held = [is_jointed(model, int(j)) for j in bound.ids]
        if not any(held) or not (all(held) or self.target == "*"):
            raise BadEffect(
                f"{self.name} on {self.target!r}: it needs hinges, slides or balls, name the ones you mean; a free "
                "joint has no bearing (fluid_drag holds back what flies, payload makes it heavier)"
            )
        bound.ids = bound.ids[held]
        bound.dofs, bound.qposadr = joint_dofs(model, bound.ids), joint_qpos(model, bound.ids)
        return bound
