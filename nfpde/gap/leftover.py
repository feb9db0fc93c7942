"""What remains: whether a free-form force could still shrink the gap, by how much, and what it looks like."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.elements import actuator_ctrls
from nfpde.gap.noise import Scatter
from nfpde.gap.recordings import Recordings
from nfpde.gap.regimes import joint_columns
from nfpde.gap.report import ResidualForce
from nfpde.gap.where import Forces

Array = NDArray[np.float64]

_KNOTS = 12
_RIDGES = np.logspace(-3, 3, 13)

_CLEAR = 3.0
"""Standard errors of the mean of noise alone, by which residuals must be beyond it for a share of that to mean
anything."""


@dataclass(frozen=True, eq=False)
class Leftover:
    """What a smooth force on one degree of freedom takes away on held-out windows.

    dof: the degree of freedom
    share: of the squared whitened residual beyond noise that it removes there, 0 to 1; none where noise may be all
    held: forces that the held-out windows lack
    """

    dof: int
    share: float
    held: Forces


def leftover(
    recordings: Recordings,
    fit: Forces,
    held: Forces,
    noise: Scatter,
    residuals: Array,
    quiet: Array,
    model: mujoco.MjModel,
) -> Leftover:
    """Fit a smooth force of position, speed, command and time to one half, and apply it to the other.

    It acts on the joint that lacks most.

    Args:
        recordings: Their windows.
        fit: Forces that the final model lacks in the fit's windows.
        held: The same in the held-out windows.
        noise: Scatter of the residuals when nothing is missing.
        residuals: Of the final model in the held-out windows (N, nv, C).
        quiet: Residuals that noise alone gives (draws, nv, C): their white squares have no mean of one where the
            scatter has heavy tails or a floor.
        model: Its actuators tell which command belongs to which degree of freedom.
    """
    # what diverged is as bad with any force
    sound = np.isfinite(residuals).all((1, 2))
    before = (noise.whiten(residuals[sound]) ** 2).sum((1, 2))
    alone = (noise.whiten(quiet[np.isfinite(quiet).all((1, 2))]) ** 2).sum((1, 2))
    beyond = float(before.mean() - alone.mean()) if sound.any() and len(alone) else 0.0
    clear = beyond > _CLEAR * float(alone.std(ddof=1)) / np.sqrt(len(before)) if len(alone) > 1 else False
    best: Leftover | None = None
    most = held.energy.sum(0)
    joint = int(model.dof_jntid[int(most.argmax())])
    for dof in np.flatnonzero(model.dof_jntid == joint):
        knots = _knots(_inputs(model, recordings.fit, int(dof)))
        a = _features(_inputs(model, recordings.fit, int(dof)), knots)
        b = _features(_inputs(model, recordings.held, int(dof)), knots)
        force = b @ _ridge(a, fit.value[:, dof], fit.error[:, dof])
        pushed = residuals + force[:, None, None] * held.response[dof]
        after = (noise.whiten(pushed[sound]) ** 2).sum((1, 2))
        share = float(np.clip((before - after).mean() / beyond, 0.0, 1.0)) if clear else 0.0
        found = Leftover(int(dof), share, held)
        if best is None or found.share > best.share:
            best = found
    if best is None:
        raise RuntimeError("the model has no degree of freedom")
    return best


def describe(found: Leftover, model: mujoco.MjModel, windows: Windows) -> ResidualForce:
    """The force that is left over on a joint, window by window, for a picture."""
    names, columns = joint_columns(model)
    joint = next(j for j, dofs in enumerate(columns) if found.dof in dofs)
    inputs = _inputs(model, windows, found.dof)
    unit = "N" if _slides(model, found.dof) else "Nm"
    value, error = found.held.value[:, found.dof], found.held.error[:, found.dof]
    return ResidualForce(names[joint], unit, found.share, inputs[0], inputs[1], inputs[2], value, error)


def _inputs(model: mujoco.MjModel, windows: Windows, dof: int) -> list[Array]:
    """Position, speed, command and time of every window, for a degree of freedom."""
    joint = int(model.dof_jntid[dof])
    drives = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
    commands = windows.ctrl[:, :, actuator_ctrls(model, np.flatnonzero(drives))]
    command = commands.mean((1, 2)) if commands.size else np.zeros(len(windows))
    speed = windows.state[:, :, model.nq + dof].mean(1)
    return [_position(model, windows, dof), speed, command, windows.row.astype(float)]


def _position(model: mujoco.MjModel, windows: Windows, dof: int) -> Array:
    """Mean coordinate of a degree of freedom; of one that turns freely its part of the rotation halfway, from qpos0."""
    joint = int(model.dof_jntid[dof])
    if _slides(model, dof) or model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
        return windows.state[:, :, int(model.jnt_qposadr[joint]) + (dof - int(model.jnt_dofadr[joint]))].mean(1)
    out, turned = np.empty(len(windows)), np.empty(model.nv)
    for n, state in enumerate(windows.state[:, windows.horizon // 2]):
        mujoco.mj_differentiatePos(model, turned, 1.0, model.qpos0, state[: model.nq])
        out[n] = turned[dof]
    return out


def _slides(model: mujoco.MjModel, dof: int) -> bool:
    """Whether a degree of freedom is a distance: of a slide, or one of the first three of a free joint."""
    joint = int(model.dof_jntid[dof])
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
        return dof - int(model.jnt_dofadr[joint]) < 3
    return bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE)


def _knots(inputs: list[Array]) -> list[Array]:
    return [np.unique(np.quantile(x, np.linspace(0, 1, _KNOTS))) for x in inputs]


def _features(inputs: list[Array], knots: list[Array]) -> Array:
    """Additive piecewise-linear functions of every input, and a constant."""
    columns = [np.ones((len(inputs[0]), 1))]
    for x, at in zip(inputs, knots, strict=True):
        if len(at) > 1:
            columns.append(np.stack([np.interp(x, at, row) for row in np.eye(len(at))], axis=1))
    return np.hstack(columns)


def _ridge(features: Array, force: Array, error: Array) -> Array:
    """Ridge regression with weights from the errors, its strength by generalised cross-validation."""
    limit = np.quantile(np.abs(force), 0.98)
    calm = np.clip(force, -limit, limit)
    spread = float(np.sqrt((calm**2).mean()))
    if spread == 0.0:
        return np.zeros(features.shape[1])
    weight = 1.0 / np.hypot(error / spread, 1.0)
    a, y = features * weight[:, None], calm * weight
    u, s, vt = np.linalg.svd(a, full_matrices=False)
    best, answer = np.inf, np.zeros(features.shape[1])
    for strength in _RIDGES * max(float(s[0]) ** 2 / len(y), 1e-300):
        shrink = s**2 / (s**2 + strength)
        left = y - u @ (shrink * (u.T @ y))
        score = float((left**2).mean() / (1 - shrink.sum() / len(y)) ** 2)
        if score < best:
            best, answer = score, vt.T @ (s / (s**2 + strength) * (u.T @ y))
    return answer
