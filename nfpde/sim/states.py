"""The layout of a state and the difference of two states, quaternions included."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.elements import element_names

Array = NDArray[np.float64]

_SUFFIXES = {0: ("x", "y", "z", "rx", "ry", "rz"), 1: ("rx", "ry", "rz"), 2: ("",), 3: ("",)}


@dataclass(frozen=True)
class StateSpace:
    """State = (qpos, qvel), joined; differences live in the tangent space, 2 nv numbers.

    channels: name of every number of a difference, positions first          (ndiff,)
    nq, nv: sizes of qpos and qvel
    quaternions: first qpos column and first velocity of each unit quaternion
    """

    channels: tuple[str, ...]
    nq: int
    nv: int
    quaternions: tuple[tuple[int, int], ...] = ()

    @property
    def nx(self) -> int:
        """Numbers in a state, nq + nv."""
        return self.nq + self.nv

    @property
    def ndiff(self) -> int:
        """Numbers in a difference of two states."""
        return len(self.channels)

    @property
    def axes(self) -> list[tuple[int, int]]:
        """Columns in qpos and in qvel of every position that has its speed beside it: all but rotations of bodies."""
        if self.nq - self.nv != len(self.quaternions):
            return []
        turning = {q + k for q, _ in self.quaternions for k in range(4)}
        before = [sum(first < q for first, _ in self.quaternions) for q in range(self.nq)]
        return [(q, q - before[q]) for q in range(self.nq) if q not in turning]

    def difference(self, predicted: Array, measured: Array) -> Array:
        """Predicted - measured, (..., nq+nv) twice (broadcast) to (..., ndiff).

        Angles of hinges are not wrapped: a log whose encoder wraps must be unwrapped first. For a quaternion it is
        the rotation vector from measured to predicted in the body's frame [rad], as mj_differentiatePos with dt = 1.
        """
        raw = predicted - measured
        if not self.quaternions:
            return raw
        parts, column = [], 0
        for q, _ in self.quaternions:
            parts.append(raw[..., column:q])
            parts.append(_rotation_between(measured[..., q : q + 4], predicted[..., q : q + 4]))
            column = q + 4
        parts.append(raw[..., column:])
        return np.concatenate(parts, axis=-1)

    def moved(self, state: Array, step: Array) -> Array:
        """States moved along tangent vectors, (..., nq+nv) and (..., ndiff) to (..., nq+nv): undoes `difference`.

        A rotation vector [rad] turns a unit quaternion in the body's frame, as mj_integratePos with dt = 1.
        """
        if not self.quaternions:
            return state + step
        parts, column, tangent = [], 0, 0
        for q, v in self.quaternions:
            parts.append(state[..., column:q] + step[..., tangent:v])
            parts.append(_turned(state[..., q : q + 4], step[..., v : v + 3]))
            column, tangent = q + 4, v + 3
        parts.append(state[..., column:] + step[..., tangent:])
        return np.concatenate(parts, axis=-1)

    @classmethod
    def of_model(cls, model: mujoco.MjModel) -> StateSpace:
        """The state space of a MuJoCo model."""
        positions, quaternions = [], []
        for j, name in enumerate(element_names(model, "joint")):
            kind = int(model.jnt_type[j])
            positions += [f"{name}.{s}" if s else name for s in _SUFFIXES[kind]]
            if kind < 2:
                rotation = 3 if kind == 0 else 0
                quaternions.append((int(model.jnt_qposadr[j]) + rotation, int(model.jnt_dofadr[j]) + rotation))
        channels = [f"qpos {n}" for n in positions] + [f"qvel {n}" for n in positions]
        return cls(tuple(channels), model.nq, model.nv, tuple(quaternions))

    @classmethod
    def euclidean(cls, positions: list[str], velocities: list[str]) -> StateSpace:
        """Plain vectors: every number is its own channel."""
        names = [f"qpos {n}" for n in positions] + [f"qvel {n}" for n in velocities]
        return cls(tuple(names), len(positions), len(velocities))


def _rotation_between(a: Array, b: Array) -> Array:
    """Rotation vector of conj(a) * b, (..., 4) twice to (..., 3); both are normalised first."""
    a = a / np.linalg.norm(a, axis=-1, keepdims=True)
    b = b / np.linalg.norm(b, axis=-1, keepdims=True)
    scalar = (a * b).sum(-1, keepdims=True)
    vector = a[..., :1] * b[..., 1:] - b[..., :1] * a[..., 1:] - np.cross(a[..., 1:], b[..., 1:])
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    # q and -q are one rotation: take the short way round
    angle = 2 * np.arctan2(sine, np.abs(scalar))
    ratio = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return np.where(scalar < 0, -1.0, 1.0) * ratio * vector


def _turned(quaternion: Array, rotation: Array) -> Array:
    """Quaternions (..., 4) turned by rotation vectors (..., 3) in the body's frame; unit quaternions (..., 4)."""
    a = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    # sinc is sin(pi x) / (pi x): half of it turns a rotation vector into the vector part of a quaternion
    scalar, vector = np.cos(0.5 * angle), 0.5 * np.sinc(angle / (2 * np.pi)) * rotation
    first = a[..., :1] * scalar - (a[..., 1:] * vector).sum(-1, keepdims=True)
    rest = a[..., :1] * vector + scalar * a[..., 1:] + np.cross(a[..., 1:], vector)
    return np.concatenate([first, rest], axis=-1)
