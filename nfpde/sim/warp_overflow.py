"""Buffers of MuJoCo Warp that were too small: which they were, and noticing it in every evaluation of the forces."""

import mujoco_warp as mjw
import warp as wp

from nfpde.kernels import states

_O = mjw.OverflowType
CONSTRAINTS = int(_O.NEFC | _O.NJMAX_NNZ)
CONTACTS = int(_O.BROADPHASE | _O.NARROWPHASE | _O.CCD)
COLLIDER = int(_O.EPA_HORIZON | _O.HFIELD)
"""Overflows of the collision code of meshes and height fields, whose buffers have one size."""


def flag_overflow(m: mjw.Model, d: mjw.Data) -> None:
    """Called by MuJoCo Warp in every evaluation of the forces, of which a Runge-Kutta step has four.

    No method: a batch that its own model refers to would keep its memory until Python looks for such circles.
    """
    wp.launch(
        states._flag_overflow,
        dim=d.nworld,
        inputs=[d.nefc, d.nacon, d.ncollision, d.njmax, d.naconmax, int(_O.NEFC), int(_O.NARROWPHASE)],
        outputs=[d.overflow],
    )
