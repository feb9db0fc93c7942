"""Where the gap lies: the generalized force that each joint would need in each window, sorted by regime."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.levels import CAPPED
from nfpde.gap.noise import Scatter
from nfpde.gap.regimes import Question, joint_columns, questions
from nfpde.gap.report import GapMap, Place

Array = NDArray[np.float64]

TOLD = 0.1
"""p log(p / q) of the regime that a joint's gap singles out, at least; see `places`."""


@dataclass(frozen=True, eq=False)
class Forces:
    """Generalized forces that bring a replay to the measurements, constant over each window.

    value: the forces (N, nv); error: their standard errors (N, nv), infinite where no force shows
    response: change of the residuals by a unit force (nv, N, nv, C)
    energy: squared whitened residual that each force explains, less what noise alone would give it (N, nv)
    """

    value: Array
    error: Array
    response: Array
    energy: Array


def needed_forces(fit: Fit, seen: Fitter, noise: Scatter, typical: Array, quiet: Array | None = None) -> Forces:
    """The forces that a fitted replay lacks in every window.

    Every window counts in full: weights that distrust large residuals would hide a fault that shows in few windows.

    Args:
        fit: The fitted replay.
        seen: The windows.
        noise: Scatter of the residuals when nothing is missing.
        typical: Typical generalized forces (nv,): the size of the probing force.
        quiet: Residuals that noise alone gives (N, nv, C), where the scatter has a floor above them.
    """
    nv = fit.replay.nv
    probe = 0.05 * np.maximum(typical, 1e-3 * typical.max(initial=0.0) + 1e-9)
    forces = np.vstack([np.zeros(nv), np.diag(probe)])
    xi = np.broadcast_to(fit.xi, (nv + 1, len(fit.xi)))
    there = seen.residuals_at(fit.replay, xi, forces)
    residual = there[0]
    response = (there[1:] - residual) / probe[:, None, None, None]
    response[~np.isfinite(response)] = 0.0
    rows = noise.whiten(residual).reshape(len(residual), -1)
    columns = np.stack([noise.whiten(r).reshape(len(residual), -1) for r in response], axis=2)
    information = np.einsum("nca,ncb->nab", columns, columns)
    own = np.einsum("naa->na", information)
    # a window that diverges with and without the force tells nothing of it
    shows = own > 0
    ridge = 1e-6 * np.where(shows.any(1), own.max(1, initial=0.0), 1.0)
    inverse = np.linalg.inv(information + ridge[:, None, None] * np.eye(nv))
    value = -np.einsum("nab,ncb,nc->na", inverse, columns, rows)
    variance = np.einsum("naa->na", inverse) * (1.0 if quiet is None else _loudness(noise.whiten(quiet)))
    error = np.where(shows, np.sqrt(variance), np.inf)
    return Forces(np.where(shows, value, 0.0), error, response, np.where(shows, (value**2 - variance) * own, 0.0))


def _loudness(white: Array) -> Array:
    """Mean square of white noise (N, nv, C) by degree of freedom, its largest fiftieth capped (nv,)."""
    squares = (white**2).mean(2)
    return np.minimum(squares, np.quantile(squares, 0.98, axis=0)).mean(0)


def gap_map(model: mujoco.MjModel, windows: Windows, energy: Array, capped: float = CAPPED) -> GapMap:
    """Shares of the gap by joint and regime; energies below zero (nothing but noise) count as none.

    Args:
        model: The model.
        windows: N windows.
        energy: What the force of each degree of freedom explains in each of them (N, nv), see `Forces`.
        capped: Share of the windows whose energies are capped.
    """
    names, columns = joint_columns(model)
    asked = questions(model, windows)
    energy = np.stack([energy[:, dofs].sum(1) for dofs in columns], axis=1)
    energy = np.minimum(energy, np.quantile(energy, 1.0 - capped, axis=0))
    parts = [_sums(energy, q) for q in asked]
    count = [np.stack([(q.of == r).sum(0) for r in range(len(q.answers))], axis=1) for q in asked]
    joint = parts[0].sum(1)
    # every question splits the same share of a joint; where noise leaves it no sum above zero, by windows
    for i in range(1, len(parts)):
        none = parts[i].sum(1) <= 0
        parts[i][none] = count[i][none]
        parts[i] *= (joint / np.maximum(parts[i].sum(1), 1e-300))[:, None]
    share = np.hstack(parts)
    total = joint.sum()
    groups = {q.name: len(q.answers) for q in asked}
    regimes = [a for q in asked for a in q.answers]
    return GapMap(names, regimes, share / total if total > 0 else share, np.hstack(count), groups)


def _sums(energy: Array, question: Question) -> Array:
    """Energy (N, joints) by joint and regime, none below zero (joints, regimes)."""
    sums = [np.where(question.of == r, energy, 0.0).sum(0) for r in range(len(question.answers))]
    return np.maximum(np.stack(sums, axis=1), 0.0)


def places(found: GapMap) -> list[Place]:
    """Joints by share, each with the regime that its gap singles out.

    That is the regime with most of p log(p / q), where p is its part of the joint's gap and q its part of the windows:
    one that holds much of the gap in few windows. Where none does, it is how the joint moves most of the time.
    """
    out = []
    names = list(found.groups)
    motion = found.groups[names[0]]
    for j, name in enumerate(found.joints):
        share = float(found.part(names[0])[j].sum())
        p = found.share[j] / max(share, 1e-300)
        q = found.windows[j] * len(names) / max(float(found.windows[j].sum()), 1.0)
        told = np.where(p > 0, p * np.log(np.maximum(p, 1e-300) / np.maximum(q, 1e-300)), 0.0)
        singled = int(told.argmax() if told.max() >= TOLD else p[:motion].argmax())
        out.append(Place(name, share, found.regimes[singled]))
    return sorted(out, key=lambda p: -p.share)
