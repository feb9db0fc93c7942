"""Which geoms of a robot can touch the world, and whose numbers such a contact takes."""

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
    static = _static(model)
    meets = _meets(model)
    pairs = [k for k in range(model.npair) if static[model.pair_geom1[k]] != static[model.pair_geom2[k]]]
    in_pairs = np.zeros(model.ngeom, dtype=bool)
    for k in pairs:
        in_pairs[[model.pair_geom1[k], model.pair_geom2[k]]] = True
    ground = np.flatnonzero(static & (meets.any(1) | in_pairs))
    robot = np.flatnonzero(~static & (meets.any(0) | in_pairs))
    return ground, robot, np.array(pairs, dtype=np.intp)


def meetings(model: mujoco.MjModel) -> tuple[Index, Index, NDArray[np.int32]]:
    """Every two geoms, one of the world and one that moves, whose contact takes its numbers from them.

    That of two geoms of an explicit pair takes the pair's, whatever the geoms say, and is left out.

    Returns:
        The static geom and the moving geom of each (k,), and the moving geom's `priority` above the static one's (k,):
        positive where MuJoCo takes the moving geom's numbers alone, negative where the static one's, 0 where both
        count.
    """
    meets = _meets(model)
    for one, other in ((model.pair_geom1, model.pair_geom2), (model.pair_geom2, model.pair_geom1)):
        meets[one, other] = False
    ground, robot = np.nonzero(meets)
    return ground, robot, model.geom_priority[robot] - model.geom_priority[ground]


def _static(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Whether each geom belongs to the world, (ngeom,)."""
    return model.body_weldid[model.geom_bodyid] == 0


def _meets(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Whether the masks let a static geom (row) meet a moving one (column), (ngeom, ngeom)."""
    static, contype, conaffinity = _static(model), model.geom_contype, model.geom_conaffinity
    meets = ((contype[:, None] & conaffinity[None]) | (conaffinity[:, None] & contype[None])) != 0
    return meets & static[:, None] & ~static[None]
