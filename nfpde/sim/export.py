"""A robot with fitted parameters and effects as an MJCF file, for use without this package."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.effects import Effect
from nfpde.effects.effect import overrides
from nfpde.errors import BadEffect, BadInput, BadModel, BadParameter
from nfpde.parameters import ParameterSpace
from nfpde.sim.acting import checked_effects, effect_columns, split_space
from nfpde.sim.fields import array_fields, get_field
from nfpde.sim.model import compile_file
from nfpde.sim.slots import DERIVED
from nfpde.sim.writer import ModelWriter
from nfpde.storage import write_whole

_DIGITS = 1e-4
"""Relative difference that the decimals of an MJCF file may make."""

_AUTO = int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO)

_ALWAYS = int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE)

_HOOKS = ("command", "step", "to_simulated", "to_measured")


def export_mjcf(
    model: str | Path,
    effects: Sequence[Effect],
    values: ArrayLike,
    out: str | Path,
    space: ParameterSpace | None = None,
) -> Path:
    """Write an MJCF file of a model with parameters and effects in it, where MuJoCo has their mechanism.

    What is to be written is loaded and compared, number by number, with what the simulators of this package use; where
    it differs, a file that is there already stays as it is.

    Args:
        model: MJCF or URDF file of the nominal model.
        effects: effects, not bound.
        values: those of `space` first, if there is one, then those of the effects in order, (D,), within their
            bounds. Parameters of effects may be neutral as well.
        out: file to write; its folder is made.
        space: parameters that are model fields, and after them those of effects, as a fit has them.

    Returns:
        The path of the file.

    Raises:
        BadModel: no such file, one that MuJoCo cannot compile, or one that attaches models with meshes of one name.
        BadInput: `out` is a folder.
        BadParameter: the wrong number of values, one outside its bounds, one with which MuJoCo cannot compile the
            model (moments of inertia that no body has), or one that MJCF cannot hold.
        BadEffect: an effect that acts while the simulation runs, which MJCF cannot say; `RandomizedParameters` of
            `nfpde.rl` gives it to a Gymnasium environment.

    Example:
        `export_mjcf("arm.xml", [effect("viscous_damping", "elbow", damping=(0, 1))], [0.4], "greasy_arm.xml")`
    """
    effects = checked_effects(effects)
    path, out = Path(model), Path(out)
    if out.is_dir():
        raise BadInput(f"{out}: that is a folder; give the name of the file to write, such as {out / path.name}")
    spec, nominal = compile_file(path)
    mujoco.mj_setConst(nominal, mujoco.MjData(nominal))
    base, inside = split_space(space)
    bound = [e.bind(nominal) for e in [*inside, *effects]]
    nbase = 0 if base is None else len(base)
    xi = _checked(values, base, bound)
    for e, columns in zip(bound, effect_columns(bound, nbase), strict=True):
        _refuse_hooks(e, xi[columns])
    target = copy.copy(nominal)
    ModelWriter(nominal, base, bound).write(target, xi)
    changed = _changes(nominal, target)
    for field in changed:
        if field in _WRITERS:
            _WRITERS[field](spec, nominal, target)
    _write_shorthands(spec, nominal, target)
    _find_files(spec, path)
    try:
        spec.compile()
    except ValueError as error:
        raise BadParameter(f"{out}: MuJoCo cannot compile the model with these values: {_line(error)}") from None
    text = spec.to_xml()
    _check(text, out, target, changed)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, text)
    return out


def _checked(values: ArrayLike, base: ParameterSpace | None, bound: Sequence[Effect]) -> NDArray[np.float64]:
    """The values as an array (D,), each within its bounds or, of an effect, neutral."""
    own = [(p, None) for p in base or ()]
    known = [*own, *((p, q.neutral) for e in bound for p, q in zip(e.parameters, e.quantities, strict=True))]
    try:
        xi = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        xi = None
    if xi is None or xi.shape != (len(known),) or not np.isfinite(xi).all():
        raise BadParameter(f"export: expected {len(known)} finite values, those of the space first, got {values!r}")
    for value, (p, neutral) in zip(xi, known, strict=True):
        if not p.low <= value <= p.high and value != neutral:
            also = "" if neutral is None else f", nor is it {neutral:g}, which does nothing"
            raise BadParameter(
                f"export: {p.name} = {value:g} lies outside [{p.low:g}, {p.high:g}]{also}; give a value within, or "
                "other bounds"
            )
    return xi


def _find_files(spec: mujoco.MjSpec, path: Path) -> None:
    """Say where meshes and textures are, from anywhere; those of attached models, which say it in files of their own.

    Raises:
        BadModel: a file of that name in the folders of several attached models.
    """
    own = tuple(str((path.parent / d).resolve()) for d in (spec.meshdir, spec.texturedir))
    spec.meshdir, spec.texturedir = own
    attached = [folders for file in _attached(path) for folders in [_asset_folders(file)]]
    for kind, assets in ((0, spec.meshes), (0, spec.hfields), (1, spec.textures)):
        for asset in assets:
            name = Path(asset.file).name if spec.strippath else asset.file
            if not asset.file or (Path(own[kind]) / name).is_file():
                continue
            found = {p.resolve() for folders in attached if (p := folders[kind] / name).is_file()}
            if len(found) > 1:
                raise BadModel(
                    f"export: {asset.file!r} of {asset.name!r} is in {len(found)} folders of attached models, and "
                    "MuJoCo does not say which of them it is of; give each file a name of its own"
                )
            for file in found:
                asset.file = str(file)


def _attached(path: Path) -> list[Path]:
    """Files of the models that a model attaches, and that these attach."""
    found = list[Path]()
    waiting = [path]
    while waiting:
        file = waiting.pop()
        for element in _elements(file, "model"):
            other = file.parent / element.get("file", "")
            if other.is_file() and other not in found:
                found.append(other)
                waiting.append(other)
    return found


def _asset_folders(path: Path) -> tuple[Path, Path]:
    """Where an MJCF file has its meshes, and its textures."""
    said = {name: value for element in _elements(path, "compiler") for name, value in element.items()}
    both = said.get("assetdir", "")
    return path.parent / said.get("meshdir", both), path.parent / said.get("texturedir", both)


def _elements(path: Path, name: str) -> list[ElementTree.Element]:
    try:
        return list(ElementTree.parse(path).iter(name))
    except ElementTree.ParseError:  # MuJoCo takes some files that are no XML, such as its binary ones
        return []


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def _refuse_hooks(effect: Effect, values: NDArray[np.float64]) -> None:
    hooks = [h for h in _HOOKS if overrides(effect, h)]
    if hooks and effect.active(values[None])[0]:
        raise BadEffect(
            f"{effect.name} on {effect.place}: it acts while the simulation runs ({', '.join(hooks)}), which an MJCF "
            "file cannot say; give it to a Gymnasium environment with nfpde.rl.RandomizedParameters, or simulate it "
            "with nfpde.sim.MujocoSimulator"
        )


def _changes(nominal: mujoco.MjModel, target: mujoco.MjModel) -> list[str]:
    """Fields in which two compiled models differ."""
    return [f for f in array_fields(nominal) if not np.array_equal(get_field(nominal, f), get_field(target, f))]


def _check(text: str, out: Path, target: mujoco.MjModel, changed: list[str]) -> None:
    """Load what the file is to hold and compare it with what was to be written, what was not to change included.

    Raises:
        BadModel: what MuJoCo itself cannot load, or loads with other meshes.
        BadParameter: a field that did not arrive, or one that came along.
    """
    try:
        found = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise BadModel(f"{out}: what MuJoCo writes of this model it cannot read again: {_line(error)}") from None
    mujoco.mj_setConst(found, mujoco.MjData(found))
    if not _close(target.mesh_vert, found.mesh_vert):
        raise BadModel(
            f"{out}: what MuJoCo writes of this model has other meshes; where attached models have files of the same "
            "name, give each a name of its own"
        )
    other = [f for f in array_fields(target) if not _close(get_field(target, f), get_field(found, f))]
    wrong = [f for f in other if f in changed and not f.startswith(_FOLLOW)]
    if not wrong and not _close(_inertias(target), _inertias(found)):
        wrong = ["body_inertia"]
    if wrong:
        raise BadParameter(f"{out}: an MJCF file made from this model cannot hold the changed field {wrong[0]}")
    moved = [f for f in other if not f.startswith((*_FOLLOW, *_SAID_OTHERWISE)) and not f.endswith(DERIVED)]
    if moved:
        raise BadParameter(
            f"{out}: an MJCF file made from this model would change {moved[0]} as well, which the model's file leaves "
            f"to MuJoCo to work out; give it there as a number. Changed on purpose: {', '.join(changed) or 'nothing'}"
        )


_FOLLOW = ("bvh_", "body_inertia", "body_iquat", "body_sameframe", "geom_sameframe", "site_sameframe")
"""Fields that follow from others, or that a file may say in another way: principal axes in another order."""

_SAID_OTHERWISE = (
    *("body_simple", "dof_simplenum", "geom_size", "site_size", "M_", "D_", "B_", "map", "efm"),
    *("geom_matid", "geom_rgba", "site_matid", "site_rgba", "tendon_matid", "tendon_rgba", "actuator_history"),
)
"""More of that kind, where nothing changes them: how matrices are stored, sizes that a shape has not, looks."""


def _close(want: NDArray[Any], got: NDArray[Any]) -> bool:
    want, got = np.asarray(want, dtype=np.float64), np.asarray(got, dtype=np.float64)
    size = float(np.abs(want).max(initial=0.0))
    return want.shape == got.shape and np.allclose(got, want, rtol=_DIGITS, atol=0.1 * _DIGITS * min(size, 1e3))


def _inertias(model: mujoco.MjModel) -> NDArray[np.float64]:
    """Inertia tensors of all bodies about their centres, in their own frames, (nbody, 3, 3)."""
    turns = np.empty((model.nbody, 9))
    for turn, quat in zip(turns, model.body_iquat, strict=True):
        mujoco.mju_quat2Mat(turn, quat)
    axes = turns.reshape(-1, 3, 3)
    return np.einsum("bij,bj,bkj->bik", axes, model.body_inertia, axes)


def _per_element(field: str, elements: str, attribute: str, first_only: bool = False) -> Callable[..., None]:
    """Writes a field into the elements of a spec where it has changed."""

    def write(spec: mujoco.MjSpec, nominal: mujoco.MjModel, target: mujoco.MjModel) -> None:
        old, new = get_field(nominal, field), get_field(target, field)
        for element in getattr(spec, elements):
            at = int(nominal.jnt_dofadr[element.id]) if field.startswith("dof_") else element.id
            if np.array_equal(old[at], new[at]):
                continue
            if first_only:
                values = np.array(getattr(element, attribute), dtype=np.float64)
                values[0] = new[at]
                setattr(element, attribute, values)
            else:
                setattr(element, attribute, new[at])

    return write


def _bodies(spec: mujoco.MjSpec, nominal: mujoco.MjModel, target: mujoco.MjModel) -> None:
    fields = ("body_mass", "body_ipos", "body_iquat", "body_inertia")
    # scaled to a sum that is no longer right, or by geoms whatever a body says: then every body says its own
    every = spec.compiler.settotalmass > 0 or spec.compiler.inertiafromgeom == _ALWAYS
    spec.compiler.settotalmass = -1
    for body in spec.bodies[1:]:
        i = body.id
        if not every and all(np.array_equal(get_field(nominal, f)[i], get_field(target, f)[i]) for f in fields):
            continue
        # bodies that say an inertial are to have it, though the file may take all from geoms
        spec.compiler.inertiafromgeom = _AUTO
        body.explicitinertial = bool(target.body_mass[i])
        body.mass, body.ipos = float(target.body_mass[i]), target.body_ipos[i]
        body.iquat, body.inertia = target.body_iquat[i], target.body_inertia[i]
        body.fullinertia = np.full(6, np.nan)


def _geom_positions(spec: mujoco.MjSpec, nominal: mujoco.MjModel, target: mujoco.MjModel) -> None:
    for geom in spec.geoms:
        move = target.geom_pos[geom.id] - nominal.geom_pos[geom.id]
        if move.any():
            geom.pos = geom.pos + move
            geom.fromto = geom.fromto + np.tile(move, 2)  # NaN, and left so, where the geom has none


def _limits(spec: mujoco.MjSpec, nominal: mujoco.MjModel, target: mujoco.MjModel) -> None:
    for joint in spec.joints:
        if target.jnt_actfrclimited[joint.id]:
            joint.actfrclimited, joint.actfrcrange = 1, target.jnt_actfrcrange[joint.id]


def _write_shorthands(spec: mujoco.MjSpec, nominal: mujoco.MjModel, target: mujoco.MjModel) -> None:
    """Give numbers in place of what MuJoCo would work out anew from the changed masses.

    Those are the damping of a servo that is said as a ratio, and stiffness and damping of a joint that are said as a
    time and a ratio.
    """
    for actuator in spec.actuators:
        i = actuator.id
        said = np.concatenate([actuator.gainprm, actuator.biasprm])
        if not np.array_equal(said, np.concatenate([nominal.actuator_gainprm[i], nominal.actuator_biasprm[i]])):
            actuator.gainprm, actuator.biasprm = target.actuator_gainprm[i], target.actuator_biasprm[i]
    for joint in spec.joints:
        if not any(joint.springdamper):
            continue
        joint.springdamper = np.zeros(2)
        for name, value in (
            ("stiffness", target.jnt_stiffness[joint.id]),
            ("damping", target.dof_damping[nominal.jnt_dofadr[joint.id]]),
        ):
            values = np.array(getattr(joint, name), dtype=np.float64)
            values[0] = value
            setattr(joint, name, values)


def _option(name: str) -> Callable[..., None]:
    def write(spec: mujoco.MjSpec, nominal: mujoco.MjModel, target: mujoco.MjModel) -> None:
        setattr(spec.option, name, getattr(target.opt, name))

    return write


_WRITERS: dict[str, Any] = {
    "dof_damping": _per_element("dof_damping", "joints", "damping", first_only=True),
    "dof_armature": _per_element("dof_armature", "joints", "armature"),
    "dof_frictionloss": _per_element("dof_frictionloss", "joints", "frictionloss"),
    "jnt_stiffness": _per_element("jnt_stiffness", "joints", "stiffness", first_only=True),
    "jnt_actfrcrange": _limits,
    "geom_friction": _per_element("geom_friction", "geoms", "friction"),
    "geom_solref": _per_element("geom_solref", "geoms", "solref"),
    "geom_pos": _geom_positions,
    "pair_friction": _per_element("pair_friction", "pairs", "friction"),
    "pair_solref": _per_element("pair_solref", "pairs", "solref"),
    "actuator_gainprm": _per_element("actuator_gainprm", "actuators", "gainprm"),
    "actuator_biasprm": _per_element("actuator_biasprm", "actuators", "biasprm"),
    "actuator_gear": _per_element("actuator_gear", "actuators", "gear"),
    **dict.fromkeys(("body_mass", "body_ipos", "body_iquat", "body_inertia"), _bodies),
    **{f"opt.{o}": _option(o) for o in ("gravity", "wind", "density", "viscosity", "timestep", "magnetic")},
}
"""What writes each field that effects and parameters change into a spec; others follow when it is compiled."""
