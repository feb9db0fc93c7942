"""Forces that effects add before every physics step.

The elements of an effect differ, and effects are launched one after the other: no two threads add to one number.
"""

import warp as wp


@wp.kernel(enable_backward=False)
def _pull_joints(
    # Data in:
    qpos_in: wp.array2d[float],
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    dofid_in: wp.array[int],
    qposid_in: wp.array[int],
    first_in: int,
    effect_in: int,
    # Data out:
    qfrc_applied_out: wp.array2d[float],
):
    """Joint spring: stiffness (rest - q)."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    stiffness = float(values_in[row, first_in])
    rest = float(values_in[row, first_in + 1])
    qfrc_applied_out[worldid, dofid_in[i]] += stiffness * (rest - qpos_in[worldid, qposid_in[i]])


@wp.kernel(enable_backward=False)
def _push_bodies(
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    bodyid_in: wp.array[int],
    first_in: int,
    effect_in: int,
    # Data out:
    xfrc_applied_out: wp.array2d[wp.spatial_vector],
):
    """External force: a constant force at the body's centre of mass, in the world's frame."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    x = float(values_in[row, first_in])
    y = float(values_in[row, first_in + 1])
    z = float(values_in[row, first_in + 2])
    xfrc_applied_out[worldid, bodyid_in[i]] += wp.spatial_vector(x, y, z, 0.0, 0.0, 0.0)


@wp.kernel(enable_backward=False)
def _push_joints(
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    dofid_in: wp.array[int],
    first_in: int,
    effect_in: int,
    # Data out:
    qfrc_applied_out: wp.array2d[float],
):
    """Residual force: a constant generalized force on each degree of freedom, every one its own parameter."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    qfrc_applied_out[worldid, dofid_in[i]] += float(values_in[row, first_in + i])
