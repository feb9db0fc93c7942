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
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim.acting import effect_columns
from nfpde.sim.fields import array_fields, get_field, set_field
from nfpde.sim.limits import refuse_impossible, refuse_weightless
from nfpde.sim.quiet import quiet_mujoco
from nfpde.sim.slots import slots_of

Array = NDArray[np.float64]


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
        BadParameter: a field or element the model lacks, two parameters that write one number, one that writes
            nothing new, or bounds that no robot can have (see `nfpde.sim.limits`).
    """

    def __init__(self, model: mujoco.MjModel, space: ParameterSpace | None, effects: Sequence[Effect] = ()) -> None:
        self.nominal = copy.copy(model)
        self.nbase = 0 if space is None else len(space)
        self._slots = slots_of(self.nominal, space)
        refuse_impossible(self.nominal, self._slots)
        columns = zip(effects, effect_columns(effects, self.nbase), strict=True)
        writing = [(e, c) for e, c in columns if overrides(e, "write_model")]
        self._effects = sorted(writing, key=lambda pair: pair[0].writes_last)
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
        written = None if self._effects else self.written_rows(xi)
        for m, vector in enumerate(xi):
            if written is None:
                self._write(self._scratch, vector)
            else:  # whole fields, many times faster than parameter by parameter
                for name, value in self._nominal_fields.items():
                    self._scratch[name] = written[name][m] if name in written else value
                self._set_const(self._scratch, vector)
            for name, array in out.items():
                array[m] = self._scratch[name]
        return out

    def written_rows(self, xi: Array) -> dict[str, Array]:
        """The fields that parameters of the space name, for every vector, without what MuJoCo derives from them.

        As in `rows`, but all vectors at once: for simulators that derive the rest themselves.

        Raises:
            BadParameter: effects write into the model, one vector at a time.
        """
        if self._effects:
            raise BadParameter(f"the effect {self._effects[0][0].name} writes whole models; use rows")
        out: dict[str, Array] = {}

        def rows_of(name: str) -> Array:
            if name not in out:
                own = np.asarray(get_field(self.nominal, name), dtype=np.float64)
                out[name] = np.tile(own, (len(xi), *(1,) * own.ndim))
            return out[name]

        for slot, values in zip(self._slots, xi[:, : self.nbase].T, strict=True):
            p = slot.parameter
            column = values.reshape(-1, *(1,) * slot.nominal.ndim)
            rows_of(p.field)[(slice(None), *slot.index)] = slot.nominal * column if p.relative else column
            if slot.inertia is not None:
                ratio = column if p.relative else column / slot.nominal
                rows_of("body_inertia")[:, slot.index[0]] = slot.inertia * ratio[..., None]
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
        self._set_const(scratch, xi)

    def _set_const(self, scratch: _Scratch, xi: Array) -> None:
        """Let MuJoCo derive its constants from what was written of xi (D,)."""
        try:
            mujoco.mj_setConst(scratch.model, scratch.data)
        except (mujoco.FatalError, ValueError) as error:
            names = [s.parameter.name for s in self._slots] + [e.name for e, _ in self._effects]
            raise BadParameter(f"{', '.join(names)}: MuJoCo refuses the model with the values {xi}: {error}") from None

    def _changing_fields(self, parameters: Sequence[Parameter]) -> list[str]:
        """Every field that differs from nominal under some parameter vector, derived constants included."""
        if not parameters:
            return []
        before = {f: np.array(get_field(self.nominal, f)) for f in array_fields(self.nominal)}
        low, high = (np.array([getattr(p, side) for p in parameters]) for side in ("low", "high"))
        changed: set[str] = set()
        # irregular places in the box: a value that happens to be the model's own would hide its field
        for share in (0.0, 1.0, 0.3819, 0.7236):
            probe = _Scratch(copy.copy(self.nominal))
            with quiet_mujoco():
                self._write(probe, low + (high - low) * share)
            if share == 0.0:
                refuse_weightless(probe.model, probe.data, self._slots)
            changed |= {f for f, v in before.items() if not np.array_equal(v, probe[f], equal_nan=True)}
        for slot in self._slots:
            if slot.parameter.field not in changed:
                raise BadParameter(f"{slot.parameter.name}: no value within its bounds differs from the model's own")
        return sorted(changed)
