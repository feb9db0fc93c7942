"""Bounds that no robot can have, refused before anything is simulated.

MuJoCo's compiler refuses a mass or moment of inertia that is not positive, but nobody checks what is written into a
compiled model, where a negative number feeds energy in (damping, friction loss) or is taken for 0 (sliding friction,
density). Signs that exist are let through: a spring of negative stiffness pushes its joint over, for example.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.elements import element_ids, element_names
from nfpde.errors import BadParameter
from nfpde.parameters import UNITS, ParameterSpace
from nfpde.sim.slots import Slot

Array = NDArray[np.float64]

NONNEGATIVE = frozenset(
    [
        *("body_mass", "body_inertia", "geom_friction", "geom_size", "opt.density", "opt.viscosity"),
        *("dof_armature", "tendon_armature", "actuator_armature"),
        *("dof_damping", "tendon_damping", "actuator_damping"),
        *("dof_frictionloss", "tendon_frictionloss"),
    ]
)
"""Fields whose numbers are at least 0 in every robot."""

_INERTIA = int(mujoco.mjtWarning.mjWARN_INERTIA)


def refuse_impossible(model: mujoco.MjModel, slots: Sequence[Slot]) -> None:
    """Raise where a field of `NONNEGATIVE` can become negative, or where no inertia within the bounds can exist.

    A rigid body has no moment of inertia above the sum of the other two. A box of bounds of which a part keeps that
    rule is let through: MuJoCo simulates the rest of it as well.

    Args:
        model: the nominal model.
        slots: where the parameters are written.

    Raises:
        BadParameter: the parameter, the number, the rule.
    """
    low, high = model.body_inertia.copy(), model.body_inertia.copy()
    varied: dict[int, list[str]] = {}
    for slot in slots:
        p = slot.parameter
        lowest, highest = _reach(slot)
        if p.field in NONNEGATIVE and (lowest < 0).any():
            worst = f"{lowest.min():g} {UNITS.get(p.field, '')}".rstrip()
            raise BadParameter(
                f"{p.name}: within its bounds ({p.low:g}, {p.high:g}) {p.field} falls to {worst}; it cannot be "
                "negative: choose bounds that keep it at 0 or above"
            )
        if p.field == "body_inertia":
            low[slot.index], high[slot.index] = lowest, highest
            for body in np.atleast_1d(slot.index[0]):
                varied.setdefault(int(body), []).append(p.name)
    for body, names in varied.items():
        for axis in range(3):
            others = float(np.delete(high[body], axis).sum())
            if low[body, axis] > others * (1 + 1e-9):  # compiled inertias keep the rule but for rounding
                raise BadParameter(
                    f"{', '.join(names)}: of a body's three moments of inertia none exceeds the sum of the other two, "
                    f"yet number {axis} of body {element_names(model, 'body')[body]!r} is at least "
                    f"{low[body, axis]:g} kg m² and the others at most {others:g} together; lower the bounds of that "
                    "one or raise the others'"
                )


def refuse_weightless(model: mujoco.MjModel, data: mujoco.MjData, slots: Sequence[Slot]) -> None:
    """Raise where masses, inertias and armatures at their lower bounds leave a joint nothing to accelerate.

    A mass of 0 is possible where something else gives the joint inertia; MuJoCo warns where nothing does.

    Args:
        model: a model with all parameters at their lower bounds.
        data: what mj_setConst computed of it.
        slots: where the parameters are written.

    Raises:
        BadParameter: the parameters, the joint, the way out.
    """
    if not data.warning[_INERTIA].number:
        return
    inert = ("body_mass", "body_inertia", "dof_armature")
    names = [s.parameter.name for s in slots if s.parameter.field in inert and _reach(s)[0].min() <= mujoco.mjMINVAL]
    if names:
        joint = element_names(model, "joint")[model.dof_jntid[data.warning[_INERTIA].lastinfo]]
        raise BadParameter(
            f"{', '.join(names)}: with all parameters at their lower bounds joint {joint!r} moves something without "
            "inertia, which MuJoCo cannot simulate; raise a lower bound above 0 or give the joint an armature"
        )


def refuse_taken(model: mujoco.MjModel, space: ParameterSpace | None, effects: Sequence[Effect]) -> None:
    """Raise where a parameter changes what an effect takes from the nominal model, and would go on taking from there.

    Args:
        model: the nominal model.
        space: parameters that are model fields.
        effects: bound effects.

    Raises:
        BadParameter: the parameter, the effect, the way out.
    """
    for p in space or ():
        for e in effects:
            if p.field not in e.taken_fields:
                continue
            if np.isin(element_ids(model, "actuator", p.target, p.name), e.actuators()).any():
                raise BadParameter(
                    f"{p.name}: the effect {e.name} on {e.place} takes {p.field} from the model, and would not see "
                    "this parameter; set the value in the model and leave the parameter out, or leave the effect out"
                )


def _reach(slot: Slot) -> tuple[Array, Array]:
    """The lowest and the highest number a parameter can write into each of its entries."""
    p = slot.parameter
    ends = np.multiply.outer([p.low, p.high], slot.nominal if p.relative else np.ones_like(slot.nominal))
    return ends.min(0), ends.max(0)
