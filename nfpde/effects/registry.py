"""The one registry of effects: name to class."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TypeVar

import mujoco

from nfpde.effects.effect import Effect
from nfpde.effects.scales import DataScales
from nfpde.errors import BadEffect
from nfpde.parameters import Parameter, ParameterSpace, Target

_REGISTRY: dict[str, type[Effect]] = {}


Registered = TypeVar("Registered", bound=type[Effect])


def register(cls: Registered) -> Registered:
    """Class decorator: make an effect known by its name.

    Raises:
        BadEffect: a name used twice, or not made of letters, digits and underscores.
    """
    if not cls.name.isidentifier() or cls.name == "opt":
        raise BadEffect(f"an effect's name must be a plain identifier other than 'opt', got {cls.name!r}")
    known = _REGISTRY.get(cls.name)
    if known is not None and (known.__module__, known.__qualname__) != (cls.__module__, cls.__qualname__):
        raise BadEffect(f"an effect called {cls.name!r} is already registered ({known.__module__})")
    _REGISTRY[cls.name] = cls
    return cls


def effect_names() -> list[str]:
    """Names of all registered effects, sorted."""
    return sorted(_REGISTRY)


def effect(name: str, target: Target = None, **bounds: Sequence[float]) -> Effect:
    """An effect by its name, on a target, with bounds for its parameters.

    Raises:
        BadEffect: no such effect (the message lists them), or arguments that `Effect` refuses.

    Example:
        >>> effect("actuation_delay", "*", delay=(0.0, 0.05)).parameters[0].name
        'actuation_delay.delay:*'
    """
    return effect_class(name)(target, **bounds)


def effect_class(name: str) -> type[Effect]:
    """The class of an effect, which knows what its parameters are called and which values physics allows.

    Raises:
        BadEffect: no such effect (the message lists them).
    """
    if name not in _REGISTRY:
        raise BadEffect(f"no effect is called {name!r}; known: {', '.join(effect_names())}")
    return _REGISTRY[name]


def all_candidates(model: mujoco.MjModel, scales: DataScales, exclude: Collection[str] = ()) -> list[Effect]:
    """Every registered effect on every element of a model on which a diagnosis should try it.

    Args:
        model: The nominal model.
        scales: Typical magnitudes of the recordings.
        exclude: Names of effects to leave out.

    Raises:
        BadEffect: A name to leave out that no effect has.
    """
    unknown = sorted(set(exclude) - _REGISTRY.keys())
    if unknown:
        raise BadEffect(f"exclude: no effect is called {unknown[0]!r}; known: {', '.join(effect_names())}")
    return [e for name in effect_names() if name not in exclude for e in _REGISTRY[name].candidates(model, scales)]


def effects_in(space: ParameterSpace) -> list[Effect]:
    """The effects whose parameters are in a space (fields like `coulomb_friction.torque`), in order.

    Raises:
        BadEffect: an effect of which only some parameters are there, or one that it does not have, or one with more
            than field, target and bounds.
    """
    found: dict[tuple[str, Target], dict[str, Parameter]] = {}
    for p in space:
        head, _, tail = p.field.partition(".")
        if tail and head in _REGISTRY:
            found.setdefault((head, p.target), {})[tail] = p
    return [_effect_of(name, target, given) for (name, target), given in found.items()]


def _effect_of(name: str, target: Target, given: dict[str, Parameter]) -> Effect:
    known = [q.name for q in _REGISTRY[name].quantities]
    missing = [q for q in known if q not in given]
    if missing and given.keys() <= set(known):
        raise BadEffect(f"{name} on {target!r}: the space lacks its parameter {missing[0]!r}")
    made = effect(name, target, **{tail: (p.low, p.high) for tail, p in given.items()})
    for p in made.parameters:
        own = given[p.field.partition(".")[2]]
        if (own if own.unit else replace(own, unit=p.unit)) != p:
            raise BadEffect(f"{p.name}: a parameter of an effect may set field, target, low and high, and nothing else")
    return made
