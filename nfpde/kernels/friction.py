"""Friction that depends on the state, set before every physics step."""

import warp as wp


@wp.kernel(enable_backward=False)
def _add_stribeck_friction(
    # Data in:
    qvel_in: wp.array2d[float],
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    dofid_in: wp.array[int],
    first_in: int,
    effect_in: int,
    # Out:
    dof_frictionloss_out: wp.array2d[float],
):
    """Add coulomb + (static - coulomb) exp(-(v / speed)^2) to the friction loss of the joint's degrees of freedom."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    dofid = dofid_in[i]
    coulomb = float(values_in[row, first_in])
    static = float(values_in[row, first_in + 1])
    ratio = qvel_in[worldid, dofid] / float(values_in[row, first_in + 2])
    dof_frictionloss_out[worldid, dofid] += coulomb + (static - coulomb) * wp.exp(-ratio * ratio)
