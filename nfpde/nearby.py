"""Effects whose values are known: with bounds wide enough for robots alike, tight enough to find them again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from nfpde.effects import Effect, Quantity, effect_class
from nfpde.elements import element_names
from nfpde.errors import BadEffect
from nfpde.parameters import Target

SHARE = 0.5
"""Of a value's distance from where its effect vanishes: how far robots alike may differ, to either side."""

SPANS = 2.0
"""Half widths of a 95 % interval, to either side: about four standard errors."""

SMALLEST = 0.1
"""Reach, in its unit, of a value of which nothing says how large it may be."""

LARGEST = 1e300
"""Values have to stay below, so that there are bounds around them."""

_BEYOND = 1e9
"""A neutral value that is no size of a robot, as that of a limit which nothing reaches."""


def effect_near(
    model: mujoco.MjModel,
    name: str,
    target: Target,
    values: Mapping[str, float],
    spans: Mapping[str, float] | None = None,
) -> Effect:
    """An effect with bounds around values that are known, see `bounds_near`.

    Args:
        model: The nominal model.
        name: Of the effect.
        target: What it acts on, as a diagnosis calls it: an element, several, or what stands for the whole.
        values: Of all its parameters, by name.
        spans: Half widths of their 95 % intervals, by name.

    Raises:
        BadEffect: No such effect, target or parameter; a value missing, not finite, or one that physics does not allow.
    """
    kind = effect_class(name)
    known = [q.name for q in kind.quantities]
    if set(values) != set(known):
        raise BadEffect(f"{name}: give a value for each of {', '.join(known)}; got {', '.join(values) or 'none'}")
    for q in kind.quantities:
        value = values[q.name]
        number = isinstance(value, int | float | np.floating | np.integer) and abs(value) < LARGEST
        if not number or not q.low <= value <= q.high:
            raise BadEffect(f"{name}: {q.name} must be a number within [{q.low:g}, {q.high:g}] {q.unit}, got {value!r}")
    where = _target(model, kind, target)
    first = kind(where, **bounds_near(kind.quantities, values, spans)).bind(model)
    return kind(where, **bounds_near(first.quantities, values, spans))  # neutral may be what the model has


def _target(model: mujoco.MjModel, kind: type[Effect], target: Target) -> Target:
    """What an effect acts on, of what reports call it; all of one is that one, as a diagnosis has it."""
    if kind.kind is None:
        return None if target in (None, "", kind.whole) else target
    names = element_names(model, kind.kind)
    if target is not None and (not isinstance(target, str) or target in names):
        return target
    if target in (None, "", "*", "all", kind.whole):
        return names[0] if len(names) == 1 else "*"
    parts = tuple(str(target).split(", "))
    return parts if set(parts) <= set(names) else target


def bounds_near(
    quantities: Sequence[Quantity], values: Mapping[str, float], spans: Mapping[str, float] | None = None
) -> dict[str, tuple[float, float]]:
    """Bounds for all parameters of an effect, inside what physics allows.

    A bound lies as far from its value as half of the way to where the effect vanishes (or to zero, where that is
    nearer), and at least twice as far as the value is known. Components of a vector share the largest reach among them.

    Args:
        quantities: Of the effect.
        values: Of all of them, by name.
        spans: Half widths of their 95 % intervals, by name; 0 where they are left out.

    Example:
        >>> bounds_near([Quantity("torque", "Nm", 0.0, float("inf"), neutral=0.0)], {"torque": 0.25})
        {'torque': (0.125, 0.375)}
    """
    spans = spans or {}
    reach = {q.name: max(SHARE * _size(q, values[q.name]), SPANS * spans.get(q.name, 0.0)) for q in quantities}
    out = {}
    for q in quantities:
        alike = max(reach[other.name] for other in quantities if _stem(other) == _stem(q))
        span = alike or SMALLEST
        out[q.name] = (max(q.low, values[q.name] - span), min(q.high, values[q.name] + span))
    return out


def _size(q: Quantity, value: float) -> float:
    """How far a value is from doing nothing, or from zero, whichever is nearer and not there already."""
    meaningful = abs(q.neutral) < _BEYOND and not q.shape_only
    distances = [abs(value), *([abs(value - q.neutral)] if meaningful else [])]
    return min((d for d in distances if d > 0), default=0.0)


def _stem(q: Quantity) -> tuple[str, str]:
    """What the components of a vector have in common: `force_x` and `force_y`, but not `mass` and `position_x`."""
    for axis in ("_x", "_y", "_z"):
        if q.name.endswith(axis):
            return q.name.removesuffix(axis), q.unit
    return q.name, q.unit
