"""Loading a model: the settings that every simulator of this package shares, and the model's fingerprint."""

from __future__ import annotations

import copy
import hashlib
import warnings
from pathlib import Path

import mujoco
import numpy as np

from nfpde.errors import BadModel
from nfpde.sim.quiet import quiet_mujoco


def load_model(model: str | Path | mujoco.MjModel) -> mujoco.MjModel:
    """Load an MJCF or URDF file, or copy a compiled model, ready for this package's simulators.

    The PGS solver is replaced by Newton: MuJoCo Warp has no PGS, and a model must give the same numbers wherever it
    runs. Solver islands are switched off: a few per cent faster, and the same numbers where all joints form one tree.
    So is the search for contacts where no two geoms may collide: a seventh faster, and the same numbers.
    MuJoCo's warnings while it compiles are not shown; its errors are raised.

    Raises:
        BadModel: no such file, MuJoCo's own message where it cannot compile it, or states that recordings of (qpos,
            qvel, ctrl) do not hold: of actuators, delay buffers, plastic springs, sleeping bodies.
    """
    if isinstance(model, str | Path):
        where, (_, loaded) = str(model), compile_file(Path(model))
    else:
        where, loaded = "model", copy.copy(model)
    if loaded.na:
        raise BadModel(
            f"{where}: it has {loaded.na} actuator states (dyntype other than none), which recordings of qpos, qvel "
            "and ctrl do not hold; set dyntype='none' and model the lag with the effect actuator_lag (for "
            "<intvelocity>: a <position> actuator, with the integrated command recorded as its ctrl)"
        )
    if loaded.nhistory:
        raise BadModel(
            f"{where}: it has elements with a delay, whose buffers recordings do not hold; remove delay and nsample "
            "from actuators and sensors, and model late commands with the effect actuation_delay"
        )
    if loaded.nplastic:
        raise BadModel(
            f"{where}: it has springs that yield, whose rest length recordings do not hold; remove springyield"
        )
    if loaded.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP:
        raise BadModel(
            f"{where}: bodies may sleep in it, and recordings do not say which do; set <flag sleep='disable'/>"
        )
    if loaded.nq == 0:
        raise BadModel(f"{where}: nothing moves in it (no joint)")
    if loaded.opt.solver == mujoco.mjtSolver.mjSOL_PGS:
        loaded.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    loaded.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    if not may_collide(loaded):
        loaded.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    # compiled constants may differ from recomputed ones in the last bit; every parameter vector gets recomputed ones
    mujoco.mj_setConst(loaded, mujoco.MjData(loaded))
    return loaded


def compile_file(path: Path) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """What an MJCF or URDF file specifies, and the model of it, in which every centre of mass can be moved.

    Raises:
        BadModel: no such file, or MuJoCo's own message where it cannot compile it.
    """
    if not path.is_file():
        raise BadModel(f"{path}: no such file; give the path of an MJCF (.xml) or URDF file")
    try:
        with quiet_mujoco(), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # compiling a specification, MuJoCo warns through Python
            spec = mujoco.MjSpec.from_file(str(path))
            own = {body.name for body in spec.bodies if not body.simple}
            for body in spec.bodies:
                body.simple = 0  # a centre of mass that MuJoCo compiled as fixed to a free joint could not be moved
            model = spec.compile()
            for body in spec.bodies:  # fewer, where MuJoCo fused some
                body.simple = int(body.name not in own)  # files for other programs say what the model's file said
            return spec, model
    except ValueError as error:
        raise BadModel(f"{path}: MuJoCo cannot compile it: {' '.join(str(error).split())}") from None


def may_collide(model: mujoco.MjModel) -> bool:
    """Whether the masks of any two geoms, an explicit pair or a deformable body lets anything collide."""
    mine, others = (np.bitwise_or.reduce(bits, initial=0) for bits in (model.geom_contype, model.geom_conaffinity))
    return bool(mine & others) or model.npair > 0 or model.nflex > 0


def model_hash(model: mujoco.MjModel) -> str:
    """SHA-256 of the compiled model, to tell whether a recording belongs to it."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()
