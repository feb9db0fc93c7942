"""Which row and window each world has, and the model fields that follow from it."""

import warp as wp


@wp.kernel(enable_backward=False)
def _pair_worlds(
    # In:
    nrow_in: int,
    nvector_in: int,
    nwindow_in: int,
    # Out:
    world_row_out: wp.array[int],
    world_window_out: wp.array[int],
):
    """Give world i * nrow + j row j and window i; what is too many repeats the last one."""
    worldid = wp.tid()
    world_row_out[worldid] = wp.min(worldid % nrow_in, nvector_in - 1)
    world_window_out[worldid] = wp.min(worldid // nrow_in, nwindow_in - 1)


@wp.kernel(enable_backward=False)
def _gather_field(
    # In:
    rows_in: wp.array2d[float],
    row_in: wp.array[int],
    first_in: int,
    # Out:
    field_out: wp.array2d[float],
):
    """Copy a field of the model from the staged rows, whose columns from `first` on hold it."""
    worldid, k = wp.tid()
    field_out[worldid, k] = rows_in[row_in[worldid], first_in + k]


@wp.kernel(enable_backward=False)
def _place_static_geoms(
    # Model:
    geom_bodyid: wp.array[int],
    geom_pos: wp.array2d[wp.vec3],
    geom_quat: wp.array2d[wp.quat],
    # Data in:
    xpos_in: wp.array2d[wp.vec3],
    xquat_in: wp.array2d[wp.quat],
    # In:
    geomid_in: wp.array[int],
    # Data out:
    geom_xpos_out: wp.array2d[wp.vec3],
    geom_xmat_out: wp.array2d[wp.mat33],
):
    """Place geoms that do not move, which MuJoCo Warp does once for all worlds, by each world's own model.

    Its quaternions stand as (w, x, y, z) in arrays of wp.quat.
    """
    worldid, i = wp.tid()
    geomid = geomid_in[i]
    bodyid = geom_bodyid[geomid]
    frame = xquat_in[worldid, bodyid]
    body = wp.quat(frame[1], frame[2], frame[3], frame[0])
    own = geom_quat[worldid % geom_quat.shape[0], geomid]
    turned = body * wp.quat(own[1], own[2], own[3], own[0])
    place = wp.quat_rotate(body, geom_pos[worldid % geom_pos.shape[0], geomid])
    geom_xpos_out[worldid, geomid] = xpos_in[worldid, bodyid] + place
    geom_xmat_out[worldid, geomid] = wp.quat_to_matrix(wp.normalize(turned))
