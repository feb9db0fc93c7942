"""Whether the inertia of a body whose mass is free follows the mass: recordings are asked, nobody knows beforehand."""

from __future__ import annotations

from typing import Self

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Effect, Quantity
from nfpde.elements import element_names
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim.slots import slots_of

NAME = "inertia.follows_mass"
"""How the parameter is called, before the bodies."""

NEXT_TO = 0.05
"""Share of the way that is as good as none: the bounds of intervals that end at an end are not known better."""


class Inertia(Effect):
    """The inertia of bodies with a free mass, which follows the mass in part: nominal (mass / nominal mass)^share.

    With a share of 1 the density of the body is another (the default of `Parameter.scale_inertia`), with 0 a load sits
    in its centre. A body of which either is wrongly assumed asks for a `payload` that is not there. No effect of the
    library: it stands beside the free parameters of every diagnosis, as one more that nobody knows.
    """

    name = "inertia"
    kind = "body"
    quantities = (Quantity("follows_mass", "-", 0.0, 1.0, neutral=1.0),)
    default_bounds = {"follows_mass": (0.0, 1.0)}  # noqa: RUF012
    write_order = -1  # what loads add to a body is none of its own
    sentence = "The body's inertia differs from the model's by less than its mass does."

    mass: Array
    """Of the bodies in the nominal model (n,)."""
    inertia: Array
    """The same (n, 3)."""

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`."""
        bound = super().bind(model)
        bound.mass, bound.inertia = model.body_mass[bound.ids].copy(), model.body_inertia[bound.ids].copy()
        return bound

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Let the inertia follow in part, where a mass that is written took it along."""
        ratio = model.body_mass[self.ids] / self.mass
        follows = np.where(ratio > 0, ratio ** float(values[0]), 0.0)  # what weighs nothing has no inertia either
        model.body_inertia[self.ids] = self.inertia * follows[:, None]


def inertia_of(model: mujoco.MjModel, space: ParameterSpace | None) -> dict[Parameter, Effect]:
    """The effect on the bodies of every free mass that scales their inertias, but of bodies that never turn."""
    masses = [p for p in space or () if p.field == "body_mass" and p.scale_inertia]
    names, found = element_names(model, "body"), dict[Parameter, Effect]()
    for mass, slot in zip(masses, slots_of(model, masses), strict=True):
        bodies = [int(b) for b in np.atleast_1d(slot.index[0])]
        if any(turns(model, body) for body in bodies):
            found[mass] = Inertia(tuple(names[body] for body in bodies))
    return found


def turns(model: mujoco.MjModel, body: int) -> bool:
    """Whether any joint that carries a body lets it turn."""
    while body:
        first = model.body_jntadr[body]
        kinds = model.jnt_type[first : first + model.body_jntnum[body]]
        if (kinds != mujoco.mjtJoint.mjJNT_SLIDE).any():
            return True
        body = model.body_parentid[body]
    return False


def is_told(high: float) -> bool:
    """Whether an inertia is known not to follow the mass all the way; `high` ends the interval of its share."""
    return high < 1 - NEXT_TO


def stays(low: float, high: float) -> bool:
    """Whether an inertia is known to follow the mass part of the way at most, and may not follow it at all."""
    return low <= NEXT_TO and is_told(high)


def follows(parameter: Parameter) -> bool:
    """Whether a parameter of a replay is the one of `Inertia`."""
    return parameter.field == NAME
