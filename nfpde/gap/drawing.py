"""A robot as flat outlines: its geoms and joints, seen from where they lie apart best. Needs no graphics card."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from nfpde.elements import element_names

Array = NDArray[np.float64]

_PLANAR = 0.97
"""Share of the hinge axes' second moment along one line above which a mechanism counts as planar."""

_FLAT = 0.5
"""A robot whose height spreads less than this times its smaller horizontal spread is seen obliquely from above."""

_ELEVATION = np.radians(50.0)


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A robot projected on a plane, in metres.

    outlines: closed polygons of the geoms, farthest first, (points, 2) each; fixed: which of them cannot move
    joints: names; anchors: where they lie (joints, 2)
    ground: height of a horizontal floor, None where there is none or it cannot be seen edge on
    """

    outlines: Sequence[Array]
    fixed: Sequence[bool]
    joints: Sequence[str]
    anchors: Array
    ground: float | None


def project(model: mujoco.MjModel) -> Skeleton:
    """Outlines of a model in its first keyframe, or in `qpos0` without one.

    Args:
        model: any model; one without geoms is drawn as bones between its bodies.
    """
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    solids, fixed = _solids(model, data)
    moving = [s for s, f in zip(solids, fixed, strict=True) if not f] or solids
    points = np.vstack([*moving, data.xanchor.reshape(-1, 3)]) if moving else np.zeros((1, 3))
    right, up = view(model, data, points)
    axes = np.stack([right, up], axis=1)
    toward = np.cross(right, up)
    order = sorted(range(len(solids)), key=lambda i: float((solids[i] @ toward).mean()))
    flat, kept = [_hull(solids[i] @ axes) for i in order], [fixed[i] for i in order]
    shown = points @ axes
    low, high = shown.min(0), shown.max(0)
    reach = 0.6 * max(float((high - low).max()), 1e-6)
    near = [not f or bool(((p > low - reach) & (p < high + reach)).all()) for p, f in zip(flat, kept, strict=True)]
    ground = _ground(model, data, up, float(low[1]), reach)
    return Skeleton(
        [p for p, n in zip(flat, near, strict=True) if n],
        [f for f, n in zip(kept, near, strict=True) if n],
        element_names(model, "joint"),
        data.xanchor.reshape(-1, 3) @ axes,
        ground,
    )


def view(model: mujoco.MjModel, data: mujoco.MjData, points: Array) -> tuple[Array, Array]:
    """Unit vectors (3,) that point right and up in the picture.

    A planar mechanism is seen along its hinges. Anything else stands upright, its widest horizontal direction across;
    a flat one is seen obliquely from above.

    Args:
        model: the model.
        data: its pose.
        points: what should lie apart (n, 3).
    """
    weight = float(np.linalg.norm(model.opt.gravity))
    up = -model.opt.gravity / weight if weight > 0 else np.array([0.0, 0.0, 1.0])
    hinges = data.xaxis[model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)]
    if len(hinges):
        size, lines = np.linalg.eigh(hinges.T @ hinges)
        if size[-1] > _PLANAR * size.sum():
            normal = lines[:, -1]
            if abs(normal @ up) > _PLANAR:
                return _upright(np.array([1.0, 0.0, 0.0]), up, along=True)
            return _upright(np.cross(up, normal), up, along=False)
    spread = np.cov((points - points.mean(0)).T) if len(points) > 1 else np.eye(3)
    level = np.eye(3) - np.outer(up, up)
    size, lines = np.linalg.eigh(level @ spread @ level)
    right, raised = _upright(lines[:, -1], up, along=False)
    if up @ spread @ up < _FLAT * size[1]:
        raised = np.cos(_ELEVATION) * up + np.sin(_ELEVATION) * np.cross(up, right)
    return right, raised


def _upright(right: Array, up: Array, *, along: bool) -> tuple[Array, Array]:
    """Two orthogonal unit vectors, the first nearest to `right`; `along`: seen along `up`, from above."""
    right = right - (right @ up) * up
    if np.linalg.norm(right) < 1e-9:
        right = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    right = right / np.linalg.norm(right)
    # the sign of an eigenvector means nothing: the largest component points to the right
    right = right * np.sign(right[int(np.abs(right).argmax())])
    return right, np.cross(up, right) if along else up


def _solids(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[list[Array], list[bool]]:
    """Points on the surface of every drawn geom (n, 3), and which geoms cannot move."""
    solids, fixed = [], []
    for g in range(model.ngeom):
        local = _surface(model, g)
        if local is None or (model.geom_rgba[g, 3] == 0 and model.geom_matid[g] < 0):
            continue
        solids.append(data.geom_xpos[g] + local @ data.geom_xmat[g].reshape(3, 3).T)
        fixed.append(model.body_weldid[model.geom_bodyid[g]] == 0)
    bare = [b for b in range(1, model.nbody) if model.body_geomnum[b] == 0]
    for b in bare:
        parent = int(model.body_parentid[b])
        ends = [data.xpos[b], data.xipos[b]] + ([data.xpos[parent]] if parent else [])
        solids.append(np.array(ends))
        fixed.append(model.body_weldid[b] == 0)
    return solids, fixed


def _surface(model: mujoco.MjModel, g: int) -> Array | None:
    """Points whose convex hull is the geom, in its own frame (n, 3); None for planes and terrain."""
    kind, size = int(model.geom_type[g]), model.geom_size[g]
    shape = mujoco.mjtGeom
    end = np.array([0.0, 0.0, size[1]])
    if kind == int(shape.mjGEOM_BOX):
        return size * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    if kind == int(shape.mjGEOM_MESH):
        mesh = int(model.geom_dataid[g])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        return np.array(model.mesh_vert[first : first + count], dtype=float)
    if kind == int(shape.mjGEOM_CYLINDER):
        turn = np.linspace(0, 2 * np.pi, 32, endpoint=False)
        ring = size[0] * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
        return np.vstack([ring + end, ring - end])
    ball = _ball()
    if kind == int(shape.mjGEOM_SPHERE):
        return size[0] * ball
    if kind == int(shape.mjGEOM_ELLIPSOID):
        return size * ball
    if kind == int(shape.mjGEOM_CAPSULE):
        return np.vstack([size[0] * ball + end, size[0] * ball - end])
    return None


def _ball() -> Array:
    """Points spread over the unit sphere (n, 3)."""
    polar, turn = np.meshgrid(np.linspace(0, np.pi, 13), np.linspace(0, 2 * np.pi, 24, endpoint=False))
    polar, turn = polar.ravel(), turn.ravel()
    return np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1)


def _hull(points: Array) -> Array:
    """The outline of flat points (n, 2); a line or a point stays what it is."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return points


def _ground(model: mujoco.MjModel, data: mujoco.MjData, up: Array, low: float, reach: float) -> float | None:
    """Height of a floor that is seen edge on and near the robot."""
    for g in range(model.ngeom):
        if int(model.geom_type[g]) == int(mujoco.mjtGeom.mjGEOM_PLANE):
            height = float(data.geom_xpos[g] @ up)
            if float(data.geom_xmat[g].reshape(3, 3)[:, 2] @ up) > _PLANAR and abs(height - low) < reach:
                return height
    return None
