"""Writing parameter vectors into a model, and the model fields of many parameter vectors at once."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Effect, effect_names
from nfpde.effects.effect import overrides
from nfpde.elements import element_ids, element_names, joint_dofs, joint_qpos
from nfpde.errors import BadParameter
from nfpde.parameters import Parameter, ParameterSpace

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
_DERIVED = ("M0", "invweight0", "subtreemass", "acc0", "length0", "lengthrange", "rbound", "aabb", "sameframe")


@dataclass(frozen=True)
class _Slot:
    """Where one parameter is written: entries `index` of a field, whose own values are `nominal`.

    inertia: of the bodies whose mass it is and whose inertia follows, (n, 3), or None
    """

    parameter: Parameter
    index: tuple[NDArray[np.intp] | int, ...]
    nominal: Array
    inertia: Array | None = None


class _Scratch:
    """A model that parameter vectors are written into, with views of its fields kept from one to the next."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self._views: dict[str, NDArray[Any]] = {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        view = self._views.get(name)
        if view is None:
            view = get_field(self.model, name)
            if view.ndim:  # a scalar option is no view
                self._views[name] = view
        return view

    def __setitem__(self, name: str, value: NDArray[Any]) -> None:
        if value.ndim:
            self[name][...] = value
        else:
            set_field(self.model, name, value)


class ModelWriter:
    """Writes parameter vectors of a space into an mjModel, effects on model fields included.

    A mass scales its body's inertia by the same ratio unless the parameter says otherwise, and mj_setConst always
    recomputes what depends on the model's constants.

    Args:
        model: the nominal model; it is copied.
        space: parameters that are model fields.
        effects: bound effects; the columns of their parameters follow those of `space`.

    Raises:
        BadParameter: a field or element the model lacks, two parameters that write one number, or one that
            writes nothing new.
    """

    def __init__(self, model: mujoco.MjModel, space: ParameterSpace | None, effects: Sequence[Effect] = ()) -> None:
        self.nominal = copy.copy(model)
        self.nbase = 0 if space is None else len(space)
        self._slots = [_slot(self.nominal, p) for p in space] if space is not None else []
        _refuse_overlap(self._slots)
        self._effects: list[tuple[Effect, slice]] = []
        column = self.nbase
        for e in effects:
            if overrides(e, "write_model"):
                self._effects.append((e, slice(column, column + len(e.parameters))))
            column += len(e.parameters)
        self._scratch = _Scratch(copy.copy(self.nominal))
        everything = [*(space or ()), *(p for e in effects for p in e.parameters)]
        self._nominal_fields: dict[str, NDArray[Any]] = {}
        self.fields = self._changing_fields(everything)
        self._nominal_fields = {f: np.array(get_field(self.nominal, f)) for f in self.fields}

    def write(self, model: mujoco.MjModel, xi: Array) -> None:
        """Write one parameter vector xi (D,) into a model compiled as the nominal one was.

        Fields that an earlier vector changed go back to nominal first.

        Raises:
            BadParameter: MuJoCo refuses the model with these values.
        """
        self._write(_Scratch(model), xi)

    def rows(self, xi: Array) -> dict[str, Array]:
        """Model fields that depend on the parameters, for every vector: xi (M, D) to arrays (M, ...)."""
        out = {f: np.empty((len(xi), *v.shape), v.dtype) for f, v in self._nominal_fields.items()}
        for m, vector in enumerate(xi):
            self._write(self._scratch, vector)
            for name, array in out.items():
                array[m] = self._scratch[name]
        return out

    def nominal_values(self) -> Array:
        """The model's own value of every parameter that is a model field; NaN where its elements differ."""
        values = []
        for slot in self._slots:
            own = np.unique(np.ones_like(slot.nominal) if slot.parameter.relative else slot.nominal)
            values.append(float(own[0]) if own.size == 1 else np.nan)
        return np.array(values)

    def _write(self, scratch: _Scratch, xi: Array) -> None:
        for name, value in self._nominal_fields.items():
            scratch[name] = value
        for slot, value in zip(self._slots, xi[: self.nbase], strict=True):
            p = slot.parameter
            if slot.index:
                scratch[p.field][slot.index] = slot.nominal * value if p.relative else value
            else:
                scratch[p.field] = np.asarray(slot.nominal * value if p.relative else value)
            if slot.inertia is not None:
                scratch["body_inertia"][slot.index] = slot.inertia * (
                    value if p.relative else value / slot.nominal[:, None]
                )
        for e, columns in self._effects:
            e.write_model(scratch.model, np.asarray(xi[columns]))
        try:
            mujoco.mj_setConst(scratch.model, scratch.data)
        except (mujoco.FatalError, ValueError) as error:
            names = [s.parameter.name for s in self._slots] + [e.name for e, _ in self._effects]
            raise BadParameter(f"{', '.join(names)}: MuJoCo refuses the model with the values {xi}: {error}") from None

    def _changing_fields(self, parameters: Sequence[Parameter]) -> list[str]:
        """Every field that differs from nominal under some parameter vector, derived constants included."""
        if not parameters:
            return []
        before = {f: np.array(get_field(self.nominal, f)) for f in _array_fields(self.nominal)}
        low, high = (np.array([getattr(p, side) for p in parameters]) for side in ("low", "high"))
        changed: set[str] = set()
        # irregular places in the box: a value that happens to be the model's own would hide its field
        for share in (0.0, 1.0, 0.3819, 0.7236):
            probe = _Scratch(copy.copy(self.nominal))
            self._write(probe, low + (high - low) * share)
            changed |= {f for f, v in before.items() if not np.array_equal(v, probe[f], equal_nan=True)}
        for slot in self._slots:
            if slot.parameter.field not in changed:
                raise BadParameter(f"{slot.parameter.name}: no value within its bounds differs from the model's own")
        return sorted(changed)


def get_field(model: mujoco.MjModel, name: str) -> NDArray[Any]:
    """A live view of an mjModel field, or of an mjOption field for `opt.<name>`; a scalar option has shape ()."""
    if name.startswith("opt."):
        return np.asarray(getattr(model.opt, name[4:]))
    return getattr(model, name)


def set_field(model: mujoco.MjModel, name: str, value: NDArray[Any]) -> None:
    """Copy a value into a field of `get_field`."""
    if name.startswith("opt.") and np.ndim(value) == 0:
        setattr(model.opt, name[4:], value.item())
    else:
        get_field(model, name)[...] = value


def _array_fields(model: mujoco.MjModel) -> list[str]:
    skip = ("tex", "mesh", "hfield", "skin", "mat_", "light", "cam", "name", "key_", "flex", "plugin")
    names = [f for f in mujoco.batch.MODEL_FIELDS if not f.startswith(skip)]
    return [f for f in names if isinstance(get_field(model, f), np.ndarray)]


def _slot(model: mujoco.MjModel, p: Parameter) -> _Slot:
    if p.field.startswith("opt."):
        values = np.asarray(getattr(model.opt, p.field[4:], None))
        if p.field not in mujoco.batch.MODEL_FIELDS or values.dtype.kind != "f":
            options = sorted(f for f in mujoco.batch.MODEL_FIELDS if f.startswith("opt."))
            raise BadParameter(f"{p.name}: {p.field!r} is no real-valued option; MuJoCo has: {', '.join(options)}")
        if p.target is not None:
            raise BadParameter(f"{p.name}: an option belongs to no element; leave the target out")
        component = _component(p, values.size)
        index = (np.array([component]),) if values.ndim else ()
        return _Slot(p, index, values[index].copy())
    prefix = p.field.split("_")[0]
    kind = _KIND_OF_PREFIX.get(prefix, "")
    array = getattr(model, p.field, None) if kind else None
    if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
        close = sorted(
            f for f in _array_fields(model) if prefix == f.split("_")[0] and get_field(model, f).dtype.kind == "f"
        )
        hint = (
            f"; fields of that family: {', '.join(close)}" if close else f"; or an effect: {', '.join(effect_names())}"
        )
        raise BadParameter(f"{p.name}: {p.field!r} is no real-valued mjModel field of an element{hint}")
    if p.field.endswith(_DERIVED):
        raise BadParameter(f"{p.name}: MuJoCo derives {p.field} from other fields; vary those")
    if p.target is None:
        names = ", ".join(element_names(model, kind)[:40])
        raise BadParameter(f"{p.name}: give a target, the {kind} it belongs to; the model has: {names}")
    ids = element_ids(model, kind, p.target, p.name)
    if prefix == "dof":
        ids = joint_dofs(model, ids)
    elif prefix.startswith("qpos"):
        ids = joint_qpos(model, ids)
    index = (ids,) if array.ndim == 1 else (ids, _component(p, array.shape[1]))
    if array.ndim == 1 and p.component:
        raise BadParameter(f"{p.name}: {p.field} has one number per element, so component must be 0")
    nominal = np.array(array[index], dtype=np.float64)
    needs_nominal = p.relative or (p.field == "body_mass" and p.scale_inertia)
    if needs_nominal and not (nominal != 0).all():
        raise BadParameter(
            f"{p.name}: the model's own value is 0, so it cannot be scaled"
            + ("" if p.relative else "; a mass without inertia: set scale_inertia=False or give the body a mass")
        )
    inertia = np.array(model.body_inertia[ids]) if p.field == "body_mass" and p.scale_inertia else None
    return _Slot(p, index, nominal, inertia)


def _component(p: Parameter, size: int) -> int:
    if p.component >= size:
        raise BadParameter(f"{p.name}: {p.field} has {size} numbers, so component must be below {size}")
    return p.component


def _refuse_overlap(slots: Sequence[_Slot]) -> None:
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
