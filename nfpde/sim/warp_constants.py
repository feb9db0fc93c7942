"""Constants that MuJoCo derives from masses, inertias and armatures, on a Warp device, for all rows at once.

`mjw.set_const` does so for one right-hand side after the other, in some hundred launches of a few threads each, which
took 0.5 to 1.7 ms of every call on an H100; where mj_setConst leaves 0 for a body that only turns, it has a number; and
it writes the bounds of geoms as well, which simulators share. So it is not used.
"""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from nfpde.kernels import constants as kernels
from nfpde.sim.warp_arrays import arrays_of

DERIVED = frozenset({"body_subtreemass", "body_invweight0", "dof_invweight0", "tendon_invweight0", "actuator_acc0"})
"""Constants that are derived on the device."""


def derivable(model: mujoco.MjModel, varying: Collection[str]) -> bool:
    """Whether `WarpConstants` knows all that the constants of a model depend on; else the host derives them.

    Args:
        model: the nominal model.
        varying: fields that are other ones under some parameter vector.
    """
    tendons = any(f in varying or getattr(model, f).any() for f in ("tendon_armature", "actuator_armature"))
    adhesion = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_BODY)).any()
    return model.nv > 0 and not (tendons or adhesion or model.nmocap)


class WarpConstants:
    """Derives the constants of a model with rows of its own, on Warp's current device.

    Args:
        model: the nominal model, which must be `derivable`.
        nrow: rows.
    """

    def __init__(self, model: mujoco.MjModel, nrow: int) -> None:
        self.nrow = nrow
        self._data = mjw.make_data(model, nworld=nrow, nconmax=8, njmax=32)
        unit = np.broadcast_to(np.eye(model.nv, dtype=np.float32)[:, None], (model.nv, nrow, model.nv))
        self._unit = wp.array(unit, dtype=float)
        self._inverse = wp.zeros(self._unit.shape, dtype=float)

    def arrays(self) -> list[wp.array]:
        """All that takes memory."""
        return [*arrays_of(self._data), self._unit, self._inverse]

    def derive(self, m: mjw.Model) -> None:
        """Write the fields of `DERIVED`, of all rows of the model."""
        d, nrow, inverse = self._data, self.nrow, self._inverse
        wp.launch(
            kernels._sum_subtree,
            dim=(nrow, m.nbody),
            inputs=[m.body_subtreenum, m.body_mass],
            outputs=[m.body_subtreemass],
        )
        wp.launch(kernels._set_reference, dim=(nrow, m.nq), inputs=[m.qpos0], outputs=[d.qpos])
        for step in (mjw.kinematics, mjw.com_pos, mjw.tendon, mjw.crb, mjw.factor_m, mjw.transmission):
            step(m, d)
        for dofid in range(m.nv):
            mjw.solve_m(m, d, inverse[dofid], self._unit[dofid])
        wp.launch(
            kernels._weigh_dofs,
            dim=(nrow, m.nv),
            inputs=[m.dof_jntid, m.jnt_type, m.jnt_dofadr, inverse],
            outputs=[m.dof_invweight0],
        )
        wp.launch(
            kernels._weigh_bodies,
            dim=(nrow, m.nbody),
            inputs=[
                *(m.body_parentid, m.body_rootid, m.body_weldid, m.body_dofadr, m.body_dofnum, m.dof_parentid),
                *(d.subtree_com, d.xipos, d.cdof, inverse),
            ],
            outputs=[m.body_invweight0],
        )
        wp.launch(
            kernels._weigh_tendons,
            dim=(nrow, m.ntendon),
            inputs=[m.ten_J_rownnz, m.ten_J_rowadr, m.ten_J_colind, d.ten_J, inverse],
            outputs=[m.tendon_invweight0],
        )
        wp.launch(
            kernels._accelerate_actuators,
            dim=(nrow, m.nactuator),
            inputs=[d.moment_rownnz, d.moment_rowadr, d.moment_colind, d.actuator_moment, inverse],
            outputs=[m.actuator_acc0],
        )
