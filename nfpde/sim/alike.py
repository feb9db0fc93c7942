"""Several models of one size in one simulator: what may differ between them, and which one a parameter vector takes.

Builds of one robot, arms with one tool or another: the same bodies, joints, geoms and actuators, other numbers. Which
of them a simulation is of is a parameter like any other, `Parameter("model", low=0, high=<how many>)`: model k holds
the values from k up to k + 1. So every way to call a simulator, to sample and to fit works with them, and the share of
a fitted distribution between k and k + 1 is the probability of model k.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.elements import element_names
from nfpde.errors import BadEffect, BadModel, BadParameter
from nfpde.parameters import ParameterSpace
from nfpde.sim.fields import array_fields, get_field, set_field
from nfpde.sim.model import load_model

MODEL = "model"
"""Field of the parameter that says which model a simulation is of."""

ModelSource = str | Path | mujoco.MjModel

_SIZES = (
    *("nq", "nv", "nu", "nactuator", "nbody", "njnt", "ngeom", "nsite", "ntendon", "neq", "npair", "nmocap", "nmesh"),
    *("ngravcomp", "flg_gravcomp", "flg_adhesion", "flg_surfacevel"),
)
"""Sizes that people know, and switches; arrays of other sizes are refused by their names."""

_SHARED = ("opt.timestep", "actuator_ctrlrange")
"""Fields that simulators and effects read of one model for all: control steps, and commands that are clamped."""

_MEANINGS = {
    "body_simple": " (bodies whose centre of mass lies on their own joint are compiled in a shorter way, but not from "
    "a path given here: give all models as paths, or none)"
}
"""Words for fields that only MuJoCo's compiler writes."""

_PICTURES = ("tex", "skin", "mat_", "light", "cam", "name", "key_", "tuple", "numeric", "sensor", "bvh", "oct")
_LABELS = ("_rgba", "_user", "_matid", "_group", "pathadr", "site_size")
"""Beginnings and ends of fields that move nothing, and of trees that only make collisions faster to find."""


def load_models(model: ModelSource | Sequence[ModelSource]) -> list[mujoco.MjModel]:
    """Load one model, or several of one size; see `load_model`.

    Raises:
        BadModel: what `load_model` refuses, or the first thing in which the models differ and may not.
    """
    sources = [model] if isinstance(model, str | Path | mujoco.MjModel) else list(model)
    if not sources:
        raise BadModel("no model was given; give the path of an MJCF or URDF file, or several in a list")
    models = [load_model(source) for source in sources]
    for k, (source, other) in enumerate(zip(sources[1:], models[1:], strict=True), 1):
        _refuse_unlike(models[0], other, f"model {k}" + (f" ({source})" if isinstance(source, str | Path) else ""))
    return models


def differing_fields(models: Sequence[mujoco.MjModel]) -> list[str]:
    """Fields in which models of one size differ and that decide how they move, derived constants included."""
    first = models[0]
    return [f for f in _numbers(first) if any(not _same(get_field(first, f), get_field(m, f)) for m in models[1:])]


def model_column(space: ParameterSpace | None, count: int) -> int | None:
    """Where the parameter stands that says which of `count` models a simulation is of; None for a single model.

    Raises:
        BadParameter: it is missing where there are several models, there although there is one, or not from 0 to
            their number.
    """
    columns = [i for i, p in enumerate(space or ()) if p.field == MODEL]
    wanted = f'Parameter("{MODEL}", low=0, high={count})'
    if count == 1 and columns:
        raise BadParameter(f"the parameter {MODEL!r} chooses among several models, and one was given; leave it out")
    if count > 1 and len(columns) != 1:
        raise BadParameter(
            f"{count} models were given: the space needs one parameter that says which of them a simulation is of, "
            f"{wanted}; it has {len(columns)}"
        )
    for p in space or ():
        if p.field == MODEL and (p.target is not None or p.relative or (p.low, p.high) != (0, count)):
            raise BadParameter(f"{p.name}: to choose among {count} models it must be {wanted}, without a target")
    return columns[0] if columns else None


def refuse_unlike_effects(effects: Sequence[Effect], models: Sequence[mujoco.MjModel]) -> None:
    """Raise where an effect takes something from its model that is another in another model.

    Args:
        effects: bound to the first model.
        models: all of them.

    Raises:
        BadEffect: the effect and what it takes.
    """
    for e in effects:
        for k, model in enumerate(models[1:], 1):
            unlike = _unlike(vars(e), vars(e.bind(model)))
            if unlike:
                raise BadEffect(
                    f"{e.name} on {e.place}: it takes {unlike} from the model, and model {k} has others than model 0; "
                    "give each of these models a simulator of its own, or leave the effect out"
                )


def _refuse_unlike(first: mujoco.MjModel, other: mujoco.MjModel, name: str) -> None:
    """Raise unless the numbers of the first model, exchanged for those of the other, make it the other.

    Raises:
        BadModel: the first thing in which they differ and may not.
    """
    rule = (
        "Models of one simulator share their tree, types and sizes, and differ in real numbers only (masses, places, "
        "lengths, gains, ...); give this one a simulator of its own"
    )
    for size in _SIZES:
        if getattr(first, size) != getattr(other, size):
            raise BadModel(f"{name}: {size} is {getattr(other, size)}, in model 0 it is {getattr(first, size)}. {rule}")
    for kind in ("joint", "actuator"):
        for a, b in zip(element_names(first, kind), element_names(other, kind), strict=True):
            if a != b:
                raise BadModel(f"{name}: {kind} {b!r} is called {a!r} in model 0. Recordings name them: rename one")
    exchanged = copy.copy(first)
    shared = [*_SHARED, *(["body_pos", "body_quat"] if first.nmocap else [])]  # recordings do not say where mocaps are
    for field in _numbers(first):
        if field not in shared and get_field(first, field).shape == get_field(other, field).shape:
            set_field(exchanged, field, get_field(other, field))
    mujoco.mj_setConst(exchanged, mujoco.MjData(exchanged))
    for field in _deciding(first):
        if not _same(get_field(exchanged, field), get_field(other, field)):
            raise BadModel(f"{name}: it has another {field}{_MEANINGS.get(field, '')} than model 0. {rule}")


def _numbers(model: mujoco.MjModel) -> list[str]:
    """Real-valued fields that each simulation may have of its own."""
    return sorted(f for f in array_fields(model) if get_field(model, f).dtype.kind == "f" and _decides(f))


def _deciding(model: mujoco.MjModel) -> list[str]:
    """All fields that decide how a model moves, those first that people know."""
    own = {f for f in dir(model) if isinstance(getattr(model, f), np.ndarray)}
    options = {f"opt.{f}" for f in dir(model.opt) if not f.startswith("_")}
    found = [f for f in own | options if _decides(f)]
    return sorted(found, key=lambda f: (not f.endswith("_type"), f[0].isupper(), f))


def _decides(field: str) -> bool:
    return not field.startswith(("_", *_PICTURES)) and not field.endswith(_LABELS)


def _same(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


def _unlike(first: dict[str, Any], other: dict[str, Any]) -> str:
    """The name of the first thing that differs between two bound effects, or nothing."""
    for key, a in first.items():
        b = other.get(key)
        if isinstance(a, mujoco.MjModel):
            continue
        if isinstance(a, np.ndarray):
            same = _same(a, np.asarray(b))
        elif hasattr(a, "__dataclass_fields__"):
            same = not _unlike(vars(a), vars(b))
        else:
            same = a == b
        if not same:
            return key
    return ""
