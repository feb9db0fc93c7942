"""Effects that recorded robots have and their model lacks, to try a diagnosis on."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from nfpde.effects import Effect, effect_class
from nfpde.elements import element_names
from nfpde.errors import BadEffect
from nfpde.nearby import effect_near
from nfpde.parameters import Target


@dataclass(frozen=True, eq=False)
class Hidden:
    """An effect, with the values that all recorded robots have.

    effect: with bounds around the values
    values: in the order of its parameters
    """

    effect: Effect
    values: tuple[float, ...]


def hide(model: mujoco.MjModel, name: str, target: Target = None, /, **values: float) -> Hidden:
    """An effect for `collect` to hide in its recordings.

    Args:
        model: The nominal model.
        name: Of the effect.
        target: The element it acts on, or "*" for all of them; None where it acts on the whole, or there is one only.
        **values: Of all its parameters.

    Raises:
        BadEffect: No such effect, target or parameter; a value missing, or values that do nothing.
    """
    kind = effect_class(name).kind
    if kind is not None and target in (None, "") and len(names := element_names(model, kind)) != 1:
        raise BadEffect(f"{name} needs the {kind} it acts on, or '*' for all of them; there are: {', '.join(names)}")
    effect = effect_near(model, name, target, values).bind(model)
    chosen = tuple(float(values[q.name]) for q in effect.quantities)
    if all(v == q.neutral for v, q in zip(chosen, effect.quantities, strict=True) if not q.shape_only):
        shown = ", ".join(f"{key}={value:g}" for key, value in values.items())
        raise BadEffect(f"{name}: with {shown} it does nothing, so that there would be nothing to find")
    return Hidden(effect, chosen)
