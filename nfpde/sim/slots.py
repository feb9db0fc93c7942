"""From parameters to the numbers of a model that they write: which field, which entries, what is refused."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from nfpde.effects import effect_names
from nfpde.elements import actuator_ctrls, element_ids, element_names, joint_dofs, joint_qpos
from nfpde.errors import BadParameter
from nfpde.parameters import Parameter
from nfpde.sim.fields import array_fields, get_field

Array = NDArray[np.float64]

_KIND_OF_PREFIX = {
    "body": "body",
    "jnt": "joint",
    "dof": "joint",
    "qpos0": "joint",
    "qpos": "joint",
    "geom": "geom",
    "site": "site",
    "tendon": "tendon",
    "actuator": "actuator",
    "eq": "equality",
}
DERIVED = ("M0", "invweight0", "subtreemass", "acc0", "length0", "lengthrange", "rbound", "aabb", "sameframe")
"""Endings of fields that MuJoCo computes from others."""


@dataclass(frozen=True)
class Slot:
    """Where one parameter is written: entries `index` of a field, whose own values are `nominal`.

    inertia: of the bodies whose mass it is and whose inertia follows, (n, 3), or None
    """

    parameter: Parameter
    index: tuple[NDArray[np.intp] | int, ...]
    nominal: Array
    inertia: Array | None = None


def slots_of(model: mujoco.MjModel, parameters: Iterable[Parameter]) -> list[Slot]:
    """Where each parameter is written, in order.

    Raises:
        BadParameter: a field or element the model lacks, or two parameters that write one number.
    """
    slots = [_option(model, p) if p.field.startswith("opt.") else _elements(model, p) for p in parameters]
    _refuse_overlap(slots)
    return slots


def _option(model: mujoco.MjModel, p: Parameter) -> Slot:
    """The slot of an option, `opt.<name>`."""
    if p.field == "opt.timestep":
        raise BadParameter(
            f"{p.name}: the timestep is no parameter, because control steps and delays are counted in the model's own "
            f"({model.opt.timestep:g} s); set it in the model, <option timestep=...>, and leave the parameter out"
        )
    values = np.asarray(getattr(model.opt, p.field[4:], None))
    if p.field not in mujoco.batch.MODEL_FIELDS or values.dtype.kind != "f":
        options = sorted(f for f in mujoco.batch.MODEL_FIELDS if f.startswith("opt.") and f != "opt.timestep")
        options = [f for f in options if get_field(model, f).dtype.kind == "f"]
        raise BadParameter(f"{p.name}: {p.field!r} is no real-valued option; MuJoCo has: {', '.join(options)}")
    if p.target is not None:
        raise BadParameter(f"{p.name}: an option belongs to no element; leave the target out")
    component = _component(p, values.size)
    index = (np.array([component]),) if values.ndim else ()
    return Slot(p, index, values[index].copy())


def _elements(model: mujoco.MjModel, p: Parameter) -> Slot:
    """The slot of a field that every element of a kind has."""
    prefix = p.field.split("_")[0]
    kind = _KIND_OF_PREFIX.get(prefix, "")
    array = _field_of_elements(model, p, kind)
    if p.target is None:
        names = ", ".join(element_names(model, kind)[:40])
        raise BadParameter(f"{p.name}: give a target, the {kind} it belongs to; the model has: {names}")
    ids = element_ids(model, kind, p.target, p.name)
    if kind == "body" and p.target == "*":
        ids = ids[ids > 0]  # the world neither moves nor weighs anything
    if prefix == "dof":
        ids = joint_dofs(model, ids)
    elif prefix.startswith("qpos"):
        ids = joint_qpos(model, ids)
    elif p.field == "actuator_ctrlrange":  # one row per command, and an actuator may have several
        ids = actuator_ctrls(model, ids)
    index = (ids,) if array.ndim == 1 else (ids, _component(p, array.shape[1]))
    if array.ndim == 1 and p.component:
        raise BadParameter(f"{p.name}: {p.field} has one number per element, so component must be 0")
    nominal = np.array(array[index], dtype=np.float64)
    scales = p.field == "body_mass" and p.scale_inertia
    if p.relative and not nominal.any():
        raise BadParameter(f"{p.name}: the model's own value is 0, so it cannot be scaled")
    if scales and not (nominal != 0).all():
        without = ", ".join(element_names(model, "body")[i] for i in ids[nominal == 0])
        raise BadParameter(
            f"{p.name}: no mass, and so no inertia that could be scaled along: {without}. Name the other bodies "
            "(target takes a tuple of names), give these a mass, or set scale_inertia=False"
        )
    return Slot(p, index, nominal, np.array(model.body_inertia[ids]) if scales else None)


def _field_of_elements(model: mujoco.MjModel, p: Parameter, kind: str) -> NDArray[np.float64]:
    """A parameter's field as an array over the elements of its kind."""
    array = getattr(model, p.field, None) if kind else None
    if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
        family = p.field.split("_")[0]
        close = [f for f in array_fields(model) if f.split("_")[0] == family and get_field(model, f).dtype.kind == "f"]
        names = sorted(close) or effect_names()
        hint = f"{'fields of that family' if close else 'or an effect'}: {', '.join(names)}"
        raise BadParameter(f"{p.name}: {p.field!r} is no real-valued mjModel field of an element; {hint}")
    if p.field.endswith(DERIVED):
        raise BadParameter(f"{p.name}: MuJoCo derives {p.field} from other fields; vary those")
    return array


def _component(p: Parameter, size: int) -> int:
    if p.component >= size:
        raise BadParameter(f"{p.name}: {p.field} has {size} numbers, so component must be below {size}")
    return p.component


def _refuse_overlap(slots: Sequence[Slot]) -> None:
    owner: dict[tuple[str, int, int], str] = {}
    for slot in slots:
        p = slot.parameter
        written = [(p.field, p.component)]
        if p.field == "body_mass" and p.scale_inertia:
            written += [("body_inertia", axis) for axis in range(3)]
        for element in np.atleast_1d(slot.index[0]) if slot.index else [0]:
            for field, component in written:
                other = owner.setdefault((field, int(element), component), p.name)
                if other != p.name:
                    raise BadParameter(
                        f"{p.name} and {other} both write {field}; drop one or split the targets"
                        + (" (a mass scales the inertia unless scale_inertia=False)" if field == "body_inertia" else "")
                    )
