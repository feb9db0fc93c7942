"""Which geoms of a robot can touch the world."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.intp]


def touching(model: mujoco.MjModel) -> tuple[Index, Index, Index]:
    """Geoms of the world, geoms that move, and contact pairs of the model, that can touch each other.

    Returns:
        Ids of static geoms, of moving geoms, and of explicit pairs of one of each.
    """
    static = model.body_weldid[model.geom_bodyid] == 0
    contype, conaffinity = model.geom_contype, model.geom_conaffinity
    meets = ((contype[:, None] & conaffinity[None]) | (conaffinity[:, None] & contype[None])) != 0
    meets &= static[:, None] & ~static[None]
    pairs = [k for k in range(model.npair) if static[model.pair_geom1[k]] != static[model.pair_geom2[k]]]
    in_pairs = np.zeros(model.ngeom, dtype=bool)
    for k in pairs:
        in_pairs[[model.pair_geom1[k], model.pair_geom2[k]]] = True
    ground = np.flatnonzero(static & (meets.any(1) | in_pairs))
    robot = np.flatnonzero(~static & (meets.any(0) | in_pairs))
    return ground, robot, np.array(pairs, dtype=np.intp)
