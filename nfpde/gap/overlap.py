"""Geoms that the model lets collide though they overlap in every recorded pose."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.elements import element_names
from nfpde.sim.quiet import quiet_mujoco

Array = NDArray[np.float64]

_BITS = 31
"""Kinds of contacts, as bits of numbers with a sign."""


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


def without_contacts(model: mujoco.MjModel, pairs: Sequence[tuple[int, int]]) -> mujoco.MjModel:
    """The model without the contacts of some pairs of geoms; each of these touches whatever else it did.

    Later geoms of pairs get a bit of their own, by which all others collide with them that did so before. Where no bit
    is left, they touch nothing.
    """
    changed = copy(model)
    for i, (a, b) in enumerate(zip(model.pair_geom1, model.pair_geom2, strict=True)):
        if (a, b) in pairs or (b, a) in pairs:  # no distance is as small
            changed.pair_margin[i] = changed.pair_gap[i] = -mujoco.mjMAXVAL
    for geom in dict.fromkeys(b for _, b in pairs):
        collides = _collides(changed, geom)
        collides[[a for a, b in pairs if b == geom]] = False
        used = int(np.bitwise_or.reduce(changed.geom_contype | changed.geom_conaffinity))
        own = next((1 << bit for bit in range(_BITS) if not used >> bit & 1), 0)
        changed.geom_contype[geom], changed.geom_conaffinity[geom] = own, 0
        changed.geom_conaffinity[collides] |= own
    return changed


def _collides(model: mujoco.MjModel, geom: int) -> NDArray[np.bool_]:
    """Which geoms (ngeom,) one may collide with by its bits."""
    type_, affinity = model.geom_contype, model.geom_conaffinity
    return ((type_ & affinity[geom]) | (affinity & type_[geom])) != 0


def bodies_of(model: mujoco.MjModel, pairs: list[tuple[int, int]]) -> str:
    """The bodies of pairs of geoms, each pair once."""
    names = element_names(model, "body")
    return ", ".join(
        dict.fromkeys(f"{names[model.geom_bodyid[a]]} and {names[model.geom_bodyid[b]]}" for a, b in pairs)
    )
