"""Bodies as effects see them: which of them move, and how large they are."""

from __future__ import annotations

import mujoco
import numpy as np


def moves(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body id is that of a body with mass that some joint moves."""
    return body > 0 and int(model.body_weldid[body]) != 0 and float(model.body_mass[body]) > 0


def is_simple(model: mujoco.MjModel, body: int) -> bool:
    """Whether MuJoCo compiled the body as a free one with its centre of mass at its origin, which then must stay there.

    `<body simple="false">` in the model lifts that, and so does giving the model as a path; see `load_model`.
    """
    return int(model.body_simple[body]) != 0


def ends_chain(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body carries no other."""
    return not (model.body_parentid[1:] == body).any()


def reach(model: mujoco.MjModel, body: int) -> float:
    """Distance [m] from a body's centre of mass within which its geoms lie; at least 2 cm."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    geoms = range(first, first + count) if count else ()
    ends = [np.linalg.norm(model.geom_pos[g] - model.body_ipos[body]) + model.geom_rbound[g] for g in geoms]
    return max(float(max(ends, default=0.0)), 0.02)
