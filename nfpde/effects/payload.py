"""A load that the model does not know of."""

import math

import mujoco
import numpy as np

from nfpde.effects.bodies import ends_chain, is_simple, moves, reach
from nfpde.effects.effect import Array, Bounds, Quantity
from nfpde.effects.lever import Lever
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales

_NOWHERE = 1e-9
"""Distance [m] from the centre that is as good as none."""


@register
class Payload(Lever):
    """A point mass fixed to a body, at a position in the body's frame: mass, centre and inertia follow."""

    name = "payload"
    kind = "body"
    quantities = (
        Quantity("mass", "kg", 0.0, math.inf, neutral=0.0),
        *(Quantity(f"position_{axis}", "m", -math.inf, math.inf, neutral=0.0, shape_only=True) for axis in "xyz"),
    )
    sentence = "The body carries a mass that the model does not have."
    confounders = ("com_shift", "external_force", "gravity_tilt", "motor_strength", "armature")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to the mass of all that moves, within one and a half times the body's size from its centre.

        What ends a chain may hold a tool as long as the link before it, however small it is itself. A body that MuJoCo
        compiled as simple takes the mass at its centre only.
        """
        if not moves(model, element):
            return None
        parent = int(model.body_parentid[element])
        link = reach(model, parent) if ends_chain(model, element) and moves(model, parent) else 0.0
        far = max(1.5 * reach(model, element), link) if not is_simple(model, element) else _NOWHERE
        mass = float(model.body_subtreemass[model.body_rootid[element]])
        centre = model.body_ipos[element]
        places = {f"position_{axis}": (float(c) - far, float(c) + far) for axis, c in zip("xyz", centre, strict=True)}
        return {"mass": (0.0, mass), **places}

    def screened(self, scales: DataScales) -> Array:
        """Light at the centre, heavier to every side."""
        mass = self.parameters[0].high
        middle = np.array([0.5 * (p.low + p.high) for p in self.parameters[1:]])
        far = np.array([0.5 * (p.high - p.low) for p in self.parameters[1:]]) / 1.5
        sides = np.diag(far)
        return np.array(
            [[0.02 * mass, *middle], *([0.05 * mass, *(middle + s * side)] for side in sides for s in (1, -1))]
        )

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Add the mass; the parallel-axis theorem moves the inertia to the new centre."""
        mass, offset = float(values[0]), np.asarray(values[1:])
        if mass == 0.0:
            return
        for body in self.ids:
            own = float(model.body_mass[body])
            # what a simple body allows is its centre; the difference is below any meaning
            near = is_simple(model, int(body)) and np.abs(offset - model.body_ipos[body]).max() <= 2 * _NOWHERE
            if near:
                model.body_mass[body] = own + mass
                continue
            position = offset
            centre = (own * model.body_ipos[body] + mass * position) / (own + mass)
            turn = np.empty(9)
            mujoco.mju_quat2Mat(turn, model.body_iquat[body])
            axes = turn.reshape(3, 3)
            inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
            inertia = inertia + own * _about(model.body_ipos[body] - centre) + mass * _about(position - centre)
            moments, frame = np.linalg.eigh(inertia)
            if np.linalg.det(frame) < 0:
                frame[:, 0] *= -1
            mujoco.mju_mat2Quat(model.body_iquat[body], frame.ravel())
            model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = own + mass, centre, moments


def _about(arm: Array) -> Array:
    """Inertia of a unit point mass at the end of an arm (3,) from the axis point, (3, 3)."""
    return arm @ arm * np.eye(3) - np.outer(arm, arm)
