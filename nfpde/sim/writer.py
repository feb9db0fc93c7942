"""Writing parameter vectors into a model, and the model fields of many parameter vectors at once."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.effects.effect import overrides
from nfpde.errors import BadParameter
from nfpde.parameters import ParameterSpace
from nfpde.sim.acting import effect_columns
from nfpde.sim.alike import differing_fields, model_column
from nfpde.sim.fields import array_fields, get_field, set_field
from nfpde.sim.limits import refuse_impossible, refuse_weightless
from nfpde.sim.quiet import quiet_mujoco
from nfpde.sim.slots import DERIVED, slots_of

Array = NDArray[np.float64]


class _Scratch:
    """A model that parameter vectors are written into, with views of its fields kept from one to the next."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._data: mujoco.MjData | None = None
        self._views: dict[str, NDArray[Any]] = {}

    @property
    def data(self) -> mujoco.MjData:
        """What MuJoCo computes with, made when it is needed."""
        if self._data is None:
            self._data = mujoco.MjData(self.model)
        return self._data

    def release(self) -> None:
        """Let go of it: hundreds of models in one process would hold some ten MB each."""
        self._data = None

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
        model: the nominal model, or several of one size (see `nfpde.sim.alike`); they are copied.
        space: parameters that are model fields; with several models also the one that says which.
        effects: bound effects; the columns of their parameters follow those of `space`.

    Raises:
        BadParameter: a field or element the model lacks, two parameters that write one number, one that writes
            nothing new, or bounds that no robot can have (see `nfpde.sim.limits`).
    """

    def __init__(
        self,
        model: mujoco.MjModel | Sequence[mujoco.MjModel],
        space: ParameterSpace | None,
        effects: Sequence[Effect] = (),
    ) -> None:
        self.models = [copy.copy(m) for m in ([model] if isinstance(model, mujoco.MjModel) else model)]
        self.nominal = self.models[0]
        self.nbase = 0 if space is None else len(space)
        self.model_column = model_column(space, len(self.models))
        self._own = differing_fields(self.models)
        written = [(i, p) for i, p in enumerate(space or ()) if i != self.model_column]
        self._slot_columns = [i for i, _ in written]
        self._slots = [slots_of(m, [p for _, p in written]) for m in self.models]
        for m, slots in zip(self.models, self._slots, strict=True):
            refuse_impossible(m, slots)
        columns = zip(effects, effect_columns(effects, self.nbase), strict=True)
        writing = [(e, c) for e, c in columns if overrides(e, "write_model")]
        self._effects = sorted(writing, key=lambda pair: pair[0].write_order)
        self._scratch = _Scratch(copy.copy(self.nominal))
        everything = [*(space or ()), *(p for e in effects for p in e.parameters)]
        low, high = (np.array([getattr(p, side) for p in everything]) for side in ("low", "high"))
        self.probes = _probes(low, high, self.model_column, len(self.models))
        self._nominal_fields = self._fields_of_models(self._own)
        self.fields = self._changing_fields()
        self._nominal_fields = self._fields_of_models(self.fields)

    def which(self, xi: Array) -> NDArray[np.intp]:
        """The model of each parameter vector, xi (M, D) to (M,)."""
        if self.model_column is None:
            return np.zeros(len(xi), np.intp)
        return np.minimum(xi[:, self.model_column].astype(np.intp), len(self.models) - 1)

    def write(self, model: mujoco.MjModel, xi: Array) -> None:
        """Write one parameter vector xi (D,) into a model compiled as the nominal one was.

        Fields that an earlier vector changed go back to nominal first.

        Raises:
            BadParameter: MuJoCo refuses the model with these values.
        """
        self._write(_Scratch(model), xi)

    def rows(self, xi: Array) -> dict[str, Array]:
        """Model fields that depend on the parameters, for every vector: xi (M, D) to arrays (M, ...)."""
        out = {f: np.empty((len(xi), *v.shape), v.dtype) for f, v in self._nominal_fields[0].items()}
        written = None if self._effects else self.written_rows(xi)
        which = self.which(xi)
        for m, vector in enumerate(xi):
            if written is None:
                self._write(self._scratch, vector)
            else:  # whole fields, many times faster than parameter by parameter
                for name, value in self._nominal_fields[which[m]].items():
                    self._scratch[name] = written[name][m] if name in written else value
                self._set_const(self._scratch, vector)
            for name, array in out.items():
                array[m] = self._scratch[name]
        self._scratch.release()
        return out

    def written_rows(self, xi: Array) -> dict[str, Array]:
        """The fields that parameters of the space name, for every vector, without what MuJoCo derives from them.

        Of several models, also the fields in which they differ. As in `rows`, but all vectors at once: for simulators
        that derive the rest themselves.

        Raises:
            BadParameter: effects write into the model, one vector at a time.
        """
        if self._effects:
            raise BadParameter(f"the effect {self._effects[0][0].name} writes whole models; use rows")
        out: dict[str, Array] = {}
        which = self.which(xi)

        def rows_of(name: str) -> Array:
            if name not in out:
                own = np.array([get_field(m, name) for m in self.models], dtype=np.float64)
                out[name] = own[which]
            return out[name]

        for name in self._own:
            if not name.endswith(DERIVED):
                rows_of(name)
        for k, slots in enumerate(self._slots):
            own = np.flatnonzero(which == k)
            for slot, values in zip(slots, xi[own][:, self._slot_columns].T, strict=True):
                p = slot.parameter
                shape = (-1, *(1,) * slot.nominal.ndim)
                rows, column = own.reshape(shape), values.reshape(shape)
                rows_of(p.field)[(rows, *slot.index)] = slot.nominal * column if p.relative else column
                if slot.inertia is not None:
                    ratio = column if p.relative else column / slot.nominal
                    rows_of("body_inertia")[rows, slot.index[0]] = slot.inertia * ratio[..., None]
        return out

    def nominal_values(self) -> Array:
        """The model's own value of every parameter that is a model field; NaN where its elements, or models, differ."""
        values = np.full(self.nbase, np.nan)
        for column, *slots in zip(self._slot_columns, *self._slots, strict=True):
            own = np.unique([np.ones_like(s.nominal) if s.parameter.relative else s.nominal for s in slots])
            if own.size == 1:
                values[column] = own[0]
        return values

    def _write(self, scratch: _Scratch, xi: Array) -> None:
        k = int(self.which(xi[None])[0])
        for name, value in self._nominal_fields[k].items():
            scratch[name] = value
        for slot, value in zip(self._slots[k], xi[self._slot_columns], strict=True):
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
        self._set_const(scratch, xi)

    def _set_const(self, scratch: _Scratch, xi: Array) -> None:
        """Let MuJoCo derive its constants from what was written of xi (D,)."""
        try:
            mujoco.mj_setConst(scratch.model, scratch.data)
        except (mujoco.FatalError, ValueError) as error:
            names = [s.parameter.name for s in self._slots[0]] + [e.name for e, _ in self._effects]
            raise BadParameter(f"{', '.join(names)}: MuJoCo refuses the model with the values {xi}: {error}") from None

    def _fields_of_models(self, names: Sequence[str]) -> list[dict[str, NDArray[Any]]]:
        """The own values of each model."""
        return [{f: np.array(get_field(m, f)) for f in names} for m in self.models]

    def _changing_fields(self) -> list[str]:
        """Every field that differs from nominal under some parameter vector, derived constants included."""
        names = array_fields(self.nominal)
        # hundreds of fields for every candidate effect, nearly all as they were: bytes are compared in far less time
        before = [{f: get_field(m, f).tobytes() for f in names} for m in self.models]
        changed: set[str] = set()
        varied: set[str] = set()
        for i, vector in enumerate(self.probes):
            k = int(self.which(vector[None])[0])
            probe = _Scratch(copy.copy(self.nominal))
            with quiet_mujoco():
                self._write(probe, vector)
            if i < len(self.models):
                refuse_weightless(probe.model, probe.data, self._slots[k])
            there = {f: get_field(probe.model, f).tobytes() for f in names}
            varied |= {f for f in names if there[f] != before[k][f]}
            changed |= {f for f in names if there[f] != before[0][f]}
        for slot in self._slots[0]:
            if slot.parameter.field not in varied:
                raise BadParameter(f"{slot.parameter.name}: no value within its bounds differs from the model's own")
        return sorted(changed)


def _probes(low: Array, high: Array, model_column: int | None, nmodel: int) -> Array:
    """Parameter vectors that show which fields change: the lowest first, each with every model, (P, D)."""
    # irregular places in the box: a value that happens to be the model's own would hide its field
    shares = np.array([0.0, 1.0, 0.3819, 0.7236])
    vectors = np.repeat(low + shares[:, None] * (high - low), nmodel, axis=0)
    if model_column is not None:
        vectors[:, model_column] = np.tile(np.arange(nmodel), len(shares))
    return vectors if len(low) else vectors[:0]
