"""The recorded motion before a window, which effects with a memory are taken through."""

import warp as wp


@wp.kernel(enable_backward=False)
def _follow_recording(
    # In:
    past_in: wp.array3d[wp.float64],
    state_in: wp.array3d[wp.float64],
    world_window_in: wp.array[int],
    speed_in: wp.array[int],
    nq_in: int,
    npast_in: int,
    row_in: int,
    share_in: float,
    control_dt_in: float,
    # Data out:
    qpos_out: wp.array2d[float],
    qvel_out: wp.array2d[float],
):
    """Put every world where its recording was between two rows before the start; NaN where no row is known.

    Hinges and slides, whose columns of speeds are in `speed`, follow the cubic through positions and speeds, speeds go
    straight from row to row; what else there is of positions (-1 in `speed`) stays as it was in the row before.
    """
    worldid, i = wp.tid()
    window = world_window_in[worldid]
    s = share_in
    a = float(past_in[window, row_in, i])
    b = float(state_in[window, 0, i])
    if row_in + 1 < npast_in:
        b = float(past_in[window, row_in + 1, i])
    if i >= nq_in:
        qvel_out[worldid, i - nq_in] = (1.0 - s) * a + s * b
        return
    k = speed_in[i]
    if k < 0:
        qpos_out[worldid, i] = a
        return
    rate_a = control_dt_in * float(past_in[window, row_in, k])
    rate_b = control_dt_in * float(state_in[window, 0, k])
    if row_in + 1 < npast_in:
        rate_b = control_dt_in * float(past_in[window, row_in + 1, k])
    bend = (1.0 - s) * ((1.0 - s) * rate_a - s * rate_b)
    qpos_out[worldid, i] = a + s * (s * (3.0 - 2.0 * s) * (b - a) + bend)
