"""Where the gap lies: the generalized force that each joint would need in each window, by what the joint is doing."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.elements import element_names, joint_dofs
from nfpde.gap.fit import Fit
from nfpde.gap.noise import Scatter
from nfpde.gap.recordings import Recordings
from nfpde.gap.report import GapMap, Place

Array = NDArray[np.float64]

REGIMES = ("rest", "reversal", "slow", "fast")
"""What a joint does in a window: hardly moves, turns round, moves below or above its typical speed."""

_REST = 0.05
"""A joint rests where its speed stays below this share of its highest."""


@dataclass(frozen=True, eq=False)
class Forces:
    """Generalized forces that bring a replay to the measurements, constant over each window.

    value: the forces (N, nv); error: their standard errors (N, nv)
    response: change of the residuals by a unit force (nv, N, nv, C)
    energy: squared whitened residual that each force explains, less what noise alone would give it (N, nv)
    """

    value: Array
    error: Array
    response: Array
    energy: Array


def needed_forces(fit: Fit, windows: Windows, recordings: Recordings, noise: Scatter, typical: Array) -> Forces:
    """The forces that a fitted replay lacks in every window.

    Args:
        fit: The fitted replay.
        windows: Where.
        recordings: Horizons to compare at.
        noise: Scatter of the residuals when nothing is missing.
        typical: Typical generalized forces (nv,): the size of the probing force.
    """
    nv = fit.replay.nv
    probe = 0.05 * np.maximum(typical, 1e-3 * typical.max(initial=0.0) + 1e-9)
    forces = np.vstack([np.zeros(nv), np.diag(probe)])
    xi = np.broadcast_to(fit.xi, (nv + 1, len(fit.xi)))
    there = fit.replay.residuals(xi, windows, recordings.horizons, forces)
    residual = there[0]
    response = (there[1:] - residual) / probe[:, None, None, None]
    response[~np.isfinite(response)] = 0.0
    white = noise.whiten(residual)
    root = np.sqrt(noise.weights(white))[..., None]
    rows = (white * root).reshape(len(windows), -1)
    columns = np.stack([(noise.whiten(r) * root).reshape(len(windows), -1) for r in response], axis=2)
    information = np.einsum("nca,ncb->nab", columns, columns)
    own = np.einsum("naa->na", information)
    ridge = 1e-6 * own.max(1, initial=1e-300)
    inverse = np.linalg.inv(information + ridge[:, None, None] * np.eye(nv))
    value = -np.einsum("nab,ncb,nc->na", inverse, columns, rows)
    variance = np.einsum("naa->na", inverse)
    return Forces(value, np.sqrt(variance), response, (value**2 - variance) * own)


def joint_columns(model: mujoco.MjModel) -> tuple[list[str], list[NDArray[np.intp]]]:
    """Names of the joints and their degrees of freedom."""
    names = element_names(model, "joint")
    return names, [joint_dofs(model, np.array([j])) for j in range(len(names))]


def regimes_of(model: mujoco.MjModel, windows: Windows) -> NDArray[np.intp]:
    """What every joint does in every window, as an index of `REGIMES` (N, joints)."""
    speed = windows.state[:, :, model.nq :]
    _, columns = joint_columns(model)
    out = np.empty((len(windows), len(columns)), dtype=np.intp)
    for j, dofs in enumerate(columns):
        v = speed[:, :, dofs]
        size = np.linalg.norm(v, axis=2)
        rest = size.max(1) < _REST * size.max()
        turns = (v.min(1) < 0).any(1) & (v.max(1) > 0).any(1)
        slow = size.mean(1) < np.sqrt((size**2).mean())
        out[:, j] = np.select([rest, turns, slow], [0, 1, 2], 3)
    return out


def gap_map(model: mujoco.MjModel, windows: Windows, forces: Forces) -> GapMap:
    """Shares of the gap by joint and regime; energies below zero (nothing but noise) count as none."""
    names, columns = joint_columns(model)
    regime = regimes_of(model, windows)
    share = np.zeros((len(names), len(REGIMES)))
    count = np.zeros(len(REGIMES), dtype=np.intp)
    for j, dofs in enumerate(columns):
        energy = forces.energy[:, dofs].sum(1)
        energy = np.minimum(energy, np.quantile(energy, 0.98))
        for r in range(len(REGIMES)):
            share[j, r] = max(float(energy[regime[:, j] == r].sum()), 0.0)
            count[r] += int((regime[:, j] == r).sum())
    total = share.sum()
    return GapMap(names, REGIMES, share / total if total > 0 else share, count)


def places(found: GapMap, model: mujoco.MjModel, windows: Windows) -> list[Place]:
    """Joints by share, each with the regime where its gap is densest among those that hold a fair part of it."""
    regime = regimes_of(model, windows)
    out = []
    for j, name in enumerate(found.joints):
        row = found.share[j]
        count = np.array([(regime[:, j] == r).sum() for r in range(len(row))])
        fair = row >= 0.2 * max(float(row.sum()), 1e-300)
        density = np.where(fair, row / np.maximum(count, 1), -1.0)
        out.append(Place(name, float(row.sum()), found.regimes[int(density.argmax())]))
    return sorted(out, key=lambda p: -p.share)
