"""Geoms that the model lets collide though they overlap in every recorded pose."""

from __future__ import annotations

from copy import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.elements import element_names
from nfpde.sim.quiet import quiet_mujoco

Array = NDArray[np.float64]


def always_touching(model: mujoco.MjModel, qpos: Array) -> list[tuple[int, int]]:
    """Pairs of geoms that touch in every one of the poses (N, nq)."""
    data = mujoco.MjData(model)
    found: set[tuple[int, int]] | None = None
    with quiet_mujoco():
        for q in qpos:
            data.qpos[:] = q
            mujoco.mj_fwdPosition(model, data)
            pairs = data.contact.geom[(data.contact.efc_address >= 0) & (data.contact.geom >= 0).all(1)]
            here = {(int(a), int(b)) for a, b in pairs.tolist()}
            found = here if found is None else found & here
            if not found:
                return []
    return sorted(found or ())


def without_contacts(model: mujoco.MjModel, pairs: list[tuple[int, int]]) -> mujoco.MjModel:
    """The model with the later geom of every pair touching nothing."""
    changed = copy(model)
    for _, geom in pairs:
        changed.geom_contype[geom] = changed.geom_conaffinity[geom] = 0
    return changed


def bodies_of(model: mujoco.MjModel, pairs: list[tuple[int, int]]) -> str:
    """The bodies of pairs of geoms, each pair once."""
    names = element_names(model, "body")
    return ", ".join(
        dict.fromkeys(f"{names[model.geom_bodyid[a]]} and {names[model.geom_bodyid[b]]}" for a, b in pairs)
    )
