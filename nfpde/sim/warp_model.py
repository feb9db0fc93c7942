"""A model in MuJoCo Warp whose fields have one row per parameter vector."""

from __future__ import annotations

import copy
import dataclasses
import warnings
from collections.abc import Iterator
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from nfpde.effects.drive import switched_off
from nfpde.errors import BadModel
from nfpde.kernels import rows as kernels
from nfpde.parameters import ParameterSpace
from nfpde.sim.fields import get_field
from nfpde.sim.model import model_hash
from nfpde.sim.warp_constants import DERIVED, derivable
from nfpde.sim.warp_linear import LinearRows
from nfpde.sim.writer import ModelWriter

Array = NDArray[np.float64]

UNUSED = frozenset(
    {
        *("dof_M0", "dof_length", "actuator_length0", "body_margin", "bvh_aabb"),
        *("body_sameframe", "geom_sameframe", "site_sameframe"),
    }
)
"""Constants that mj_setConst derives and MuJoCo Warp does not read, or derives itself."""

_PICTURES = ("cam_", "light_")
"""Fields of cameras and lights, which move nothing."""

_LIMITS = {"jnt_actfrclimited": "jnt_actfrcrange", "actuator_forcelimited": "actuator_forcerange"}
"""Switches that all worlds share, and the ranges they switch on; a wide range does what a switch that is off does."""

_WIDE = 1e30

_LAST: dict[tuple[str, str], mjw.Model] = {}
"""The model that was put on a device last; a diagnosis makes a simulator of one model for each cause it tries."""

_FLAGS: dict[tuple[str, tuple[str, ...], bytes], dict[str, bool]] = {}
"""Switches by model, fields that vary and their signs; finding them is slow, and many simulators have the same."""

WIDE = (
    *("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_subtreemass", "body_invweight0", "jnt_stiffness"),
    *("jnt_actfrcrange", "qpos_spring", "dof_invweight0", "dof_damping", "dof_armature", "dof_frictionloss"),
    *("geom_friction", "geom_solref", "tendon_invweight0", "actuator_acc0", "actuator_gainprm", "actuator_biasprm"),
    *("actuator_gear", "actuator_forcerange", "opt.gravity", "opt.wind", "opt.density", "opt.viscosity"),
    "opt.timestep",
)
"""What parameters and effects change in most models. Small batches have rows of all of them, so that simulators whose
parameters change different ones run each other's."""

_PLACES = {"geom_pos", "geom_quat", "body_pos", "body_quat"}


@dataclasses.dataclass(frozen=True)
class Layout:
    """Fields of the model that have rows, side by side in the staged ones.

    fields: their names, in order
    fixed: those that no parameter writes, whose rows all hold the model's own values
    columns: where each stands
    width: numbers in a row
    """

    fields: tuple[str, ...]
    fixed: tuple[str, ...]
    columns: dict[str, slice]
    width: int

    @classmethod
    def of(cls, model: mujoco.MjModel, fields: set[str], fixed: set[str]) -> Layout:
        """That of such fields of a model."""
        ordered, columns, first = sorted(fields), {}, 0
        for name in ordered:
            size = get_field(model, name).size
            columns[name] = slice(first, first + size)
            first += size
        return cls(tuple(ordered), tuple(sorted(fixed)), columns, first)


class WarpModel:
    """What is common to all batches: the fields that vary, their columns in the staged rows, and all the others.

    Args:
        model: the nominal model.
        space: the parameters, those of effects included.
        writer: writes parameter vectors into it.
        step_fields: model fields that effects change before every physics step.

    Attributes:
        narrow, wide: fields that have rows in large batches, and in small ones; see `WIDE`.

    Raises:
        BadModel: MuJoCo Warp does not support the model, or one of the fields that vary.
    """

    def __init__(
        self, model: mujoco.MjModel, space: ParameterSpace, writer: ModelWriter, step_fields: list[str]
    ) -> None:
        self.model = copy.copy(model)
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR  # nobody reads them
        self.writer = writer
        self.step_fields = step_fields
        self._switches = [f for f in _LIMITS if f in writer.fields]
        needed = {*step_fields, *(_LIMITS[f] for f in self._switches)}
        fixed, unused = needed - {*writer.fields}, {*UNUSED, *self._switches}
        fields = {*writer.fields, *needed} - unused
        wide = {name for name in WIDE if get_field(model, name).size}
        self.narrow = Layout.of(self.model, fields, fixed)
        self.wide = Layout.of(self.model, fields | wide, fixed | (wide - fields))
        self.derived = self._derived_on_device(space)
        self._switch_on()
        self._linear = self._linear_rows(space)
        self.hash = model_hash(self.model)
        self.nominal = _shared(self.model, self.hash)
        for name in self.wide.fields:
            _refuse_shared(self.nominal, name)
        self.flags = self._static_flags()
        for name, value in self.flags.items():
            setattr(self.nominal, name, value)
        if wp.get_device().is_cuda and not wp.is_conditional_graph_supported():
            self.nominal.opt.graph_conditional = False  # before CUDA 12.4
        self.nominal.opt.warn_overflow = 0  # read from the data instead: printing stops the GPU
        moving = model.body_weldid[model.geom_bodyid] != 0
        on_mocap = model.body_mocapid[model.body_rootid[model.geom_bodyid]] != -1
        place = _PLACES & fields
        self.static_geoms = np.flatnonzero(~moving & ~on_mocap).astype(np.int32) if place else np.empty(0, np.int32)

    def stage(self, xi: Array, layout: Layout, *, derive: bool) -> NDArray[np.float32]:
        """The fields of every parameter vector side by side: xi (M, D) to (M, layout.width).

        With `derive`, the columns of `derived` hold nothing: `derive` computes them on the device.
        """
        if derive and self._linear is not None:
            return self._linear(xi)
        return self._rows(xi, layout, derive=derive).astype(np.float32)

    def _rows(self, xi: Array, layout: Layout, *, derive: bool) -> Array:
        out = np.zeros((len(xi), layout.width))
        written = self.writer.written_rows(xi) if derive else self.writer.rows(xi)
        for name in layout.fixed:
            written[name] = np.broadcast_to(get_field(self.model, name), (len(xi), *get_field(self.model, name).shape))
        for name in self._switches:
            off, limits = ~written[name].astype(bool), np.array(written[_LIMITS[name]])
            limits[off] = -_WIDE, _WIDE
            written[_LIMITS[name]] = limits
        for name, columns in layout.columns.items():
            if derive and name not in written:
                continue
            values = written[name].reshape(len(xi), -1)
            out[:, columns] = 1 / np.sqrt(np.maximum(values, mujoco.mjMINVAL)) if name == "opt.impratio" else values
        return out

    def put(self, layout: Layout, nrow: int, nworld: int) -> tuple[mjw.Model, dict[str, wp.array]]:
        """A model on Warp's current device, and its varying fields, not filled yet, as (rows, numbers) of floats.

        Fields that effects change before every physics step have a row per world, the others `nrow`, of which world w
        reads row w % nrow. All that does not vary is one for all models of this call: building it is slow.
        """
        m = copy.copy(self.nominal)
        m.opt = copy.copy(m.opt)
        views = {}
        for name in layout.fields:
            n = nworld if name in self.step_fields else nrow
            owner, attribute = _where(m, name)
            array = getattr(owner, attribute)
            array = wp.zeros((n, *array.shape[1:]), dtype=array.dtype)
            array._is_batched = True  # as MuJoCo Warp marks its own
            setattr(owner, attribute, array)
            views[name] = _floats(array, get_field(self.model, name).size)
        for name in DERIVED - {*layout.fields}:  # deriving constants writes them as well
            setattr(m, name, wp.clone(getattr(m, name)))
        return m, views

    def data(self, nworld: int, nconmax: int, njmax: int) -> mjw.Data:
        """State and buffers of so many worlds, on Warp's current device.

        Every constraint may act on all degrees of freedom. In sparse models MuJoCo Warp would count on less, on none
        for friction that the nominal model lacks, and not always on more where njmax grows.
        """
        nnz = njmax * self.model.nv
        return mjw.make_data(self.model, nworld=nworld, nconmax=nconmax, njmax=njmax, njmax_nnz=nnz)

    def views(self, m: mjw.Model, names: list[str]) -> dict[str, wp.array]:
        """Fields of a model of `put`, as (rows, numbers) of floats."""
        return {n: _floats(getattr(*_where(m, n)), get_field(self.model, n).size) for n in names}

    def place_static(self, m: mjw.Model, d: mjw.Data, geoms: wp.array) -> None:
        """Put geoms of the world where each world's own model has them."""
        if geoms.size:
            mjw.kinematics(m, d)
            wp.launch(
                kernels._place_static_geoms,
                dim=(d.nworld, geoms.size),
                inputs=[m.geom_bodyid, m.geom_pos, m.geom_quat, d.xpos, d.xquat, geoms],
                outputs=[d.geom_xpos, d.geom_xmat],
            )

    def _derived_on_device(self, space: ParameterSpace) -> frozenset[str] | None:
        """Fields that the device derives from those of `written_rows`; None where the host must write all of them."""
        if self.writer.nbase < len(space):  # effects may write anything
            return None
        if not derivable(self.model, self.writer.fields):
            return None
        low = self.writer.written_rows(space.low[None])
        rest = {*self.narrow.fields} - low.keys() - {*self.narrow.fixed}
        return frozenset(rest) if rest <= DERIVED else None

    def _linear_rows(self, space: ParameterSpace) -> LinearRows | None:
        """What writes the rows of vectors of which the device derives the rest, if they are so simple."""
        if self.derived is None:
            return None
        return LinearRows.of(lambda xi: self._rows(xi, self.narrow, derive=True), space.low, space.high)

    def _switch_on(self) -> None:
        """Switch on, for all worlds, every limit that some parameter vector switches on."""
        for vector in self.writer.probes:
            if self._switches:
                changed = copy.copy(self.model)
                self.writer.write(changed, vector)
                for name in self._switches:
                    getattr(self.model, name)[...] |= getattr(changed, name)

    def _static_flags(self) -> dict[str, bool]:
        """Settings that MuJoCo Warp derives once from the model: on if any parameter vector needs them.

        Raises:
            BadModel: parameters change something that all worlds share.
        """
        flags: dict[str, bool] = {}
        for changed, signs in self._changed_models():
            key = self.hash, self.narrow.fields, signs
            if key not in _FLAGS:
                _FLAGS[key] = self._flags_of(_put(changed))
            flags |= _FLAGS[key]
        return flags

    def _flags_of(self, other: mjw.Model) -> dict[str, bool]:
        flags: dict[str, bool] = {}
        batched = {"impratio_invsqrt" if f == "opt.impratio" else f.removeprefix("opt.") for f in self.narrow.fields}
        ignored = {*batched, *UNUSED, *self._switches}
        for a, b in ((self.nominal, other), (self.nominal.opt, other.opt)):
            for f in dataclasses.fields(a):
                old, new = getattr(a, f.name), getattr(b, f.name)
                if f.name in ignored or f.name.startswith(_PICTURES) or _same(old, new):
                    continue
                if not isinstance(new, bool | np.bool_):
                    raise BadModel(
                        f"MuJoCo Warp shares {f.name} among all worlds, and the parameters or models change it: "
                        "leave out the parameter or model that does, or use device='cpu'"
                    )
                flags[f.name] = True
        return flags

    def _changed_models(self) -> Iterator[tuple[mujoco.MjModel, bytes]]:
        """Models that show all that MuJoCo Warp derives from one: every field with other numbers, and other signs.

        With the signs of each, of all fields that vary.

        Switches ask whether numbers are there at all. So of the probes, building each of which is slow, one inside
        the bounds is enough for each model, and those in which something becomes zero or ceases to be.
        """
        probes, n = self.writer.probes, len(self.writer.models)
        seen = {self._signs(self.model)}
        for i, vector in enumerate([*probes[2 * n :], *probes[: 2 * n]]):
            changed = copy.copy(self.model)
            self.writer.write(changed, vector)
            signs = self._signs(changed)
            if i < n or signs not in seen:
                seen.add(signs)
                yield changed, signs

    def _signs(self, model: mujoco.MjModel) -> bytes:
        return b"".join(np.sign(get_field(model, f), dtype=np.float64).tobytes() for f in self.writer.fields)


def _shared(model: mujoco.MjModel, model_hash: str) -> mjw.Model:
    """A model on Warp's current device, whose arrays are those of the last simulator if that had the same model."""
    key = model_hash, wp.get_device().alias
    if key not in _LAST:
        _LAST.clear()
        _LAST[key] = _put(model)
    shared = copy.copy(_LAST[key])
    shared.opt = copy.copy(shared.opt)
    return shared


def _put(model: mujoco.MjModel) -> mjw.Model:
    user = int(mujoco.mjtGain.mjGAIN_USER), int(mujoco.mjtBias.mjBIAS_USER)
    if user[0] in model.actuator_gaintype or user[1] in model.actuator_biastype:
        raise BadModel(
            "MuJoCo Warp cannot run this model: its actuators of type user call functions on the host. Give them "
            "another gaintype and biastype, or use device='cpu'"
        )
    off = np.flatnonzero(switched_off(model, np.arange(model.nactuator)))
    if len(off) and not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION):
        raise BadModel(
            f"MuJoCo Warp cannot run this model: its option actuatorgroupdisable switches off actuator #{off[0]}, and "
            "MuJoCo Warp lets it act. Give that actuator no gain and no bias, or use device='cpu'"
        )
    passive = int(mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER)
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 and model.opt.disableflags & passive == passive:
        # it calls `flag_overflow` after the passive forces, if it computes any; itself it looks at the end of a step
        raise BadModel(
            "MuJoCo Warp cannot run this model: springs and dampers are both disabled, and then it does not tell of "
            "contacts that were left out in the first three evaluations of an RK4 step. Enable one of them (stiffness "
            "or damping 0 where there is none), take another integrator, or use device='cpu'"
        )
    model = copy.copy(model)
    # MuJoCo and MuJoCo Warp 4.0 do so in every contact anyway; here the device holds what acts
    for friction in (model.geom_friction, model.pair_friction):
        np.maximum(friction, mujoco.mjMINMU, out=friction)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            put = mjw.put_model(model)
        except (NotImplementedError, ValueError) as error:
            # it refuses features by the one, and sizes and combinations of options by the other; the model is all it
            # is given, so either is about the model, and the cause stays attached
            raise _refused(error) from error
    for warning in told:
        if issubclass(warning.category, UserWarning):  # of what it computes otherwise than MuJoCo
            raise _refused(warning.message)
    return put


def _refused(reason: Exception | str) -> BadModel:
    return BadModel(
        f"MuJoCo Warp cannot run this model: {' '.join(str(reason).split())} Change that in the model, or use "
        "device='cpu'"
    )


def _floats(array: wp.array, size: int) -> wp.array:
    """An array of `size` numbers a row as (rows, size) floats, in the same memory."""
    return wp.array(ptr=array.ptr, dtype=float, shape=(array.shape[0], size), device=array.device)


def _where(m: mjw.Model, name: str) -> tuple[Any, str]:
    """The object and attribute that hold a field of the model."""
    if name == "opt.impratio":
        return m.opt, "impratio_invsqrt"
    return (m.opt, name[4:]) if name.startswith("opt.") else (m, name)


def _refuse_shared(m: mjw.Model, name: str) -> None:
    """Raise unless worlds may have a field of their own."""
    owner, attribute = _where(m, name)
    spec = {f.name: f.type for f in dataclasses.fields(owner)}.get(attribute)
    if tuple(getattr(spec, "shape", ()))[:1] != ("*",):
        raise BadModel(
            f"MuJoCo Warp has no {name} of each world's own, and the parameters or models change it: leave out the "
            "parameter or model that does, or use device='cpu'"
        )


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, wp.array) and isinstance(b, wp.array):
        if a.shape != b.shape or a.size == 0:
            return a.shape == b.shape
        left, right = a.numpy(), b.numpy()
        return np.array_equal(left, right, equal_nan=left.dtype.kind == "f")
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(_same, a, b))
    if dataclasses.is_dataclass(a) and not hasattr(a, "adr"):
        return True  # options are compared on their own; callbacks and block sizes do not come from the model
    return bool(a == b)
