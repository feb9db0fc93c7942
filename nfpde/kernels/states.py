"""Setting recorded states and commands, and noticing worlds whose numbers are wrong."""

import warp as wp

MAX_VALUE = wp.constant(1.0e10)
"""MuJoCo's limit (mjMAXVAL): positions, velocities and accelerations beyond it count as diverged."""


@wp.kernel(enable_backward=False)
def _set_start(
    # In:
    state_in: wp.array3d[wp.float64],
    world_window_in: wp.array[int],
    nq_in: int,
    nv_in: int,
    # Data out:
    qpos_out: wp.array2d[float],
    qvel_out: wp.array2d[float],
    qacc_warmstart_out: wp.array2d[float],
    qfrc_applied_out: wp.array2d[float],
    time_out: wp.array[float],
    overflow_out: wp.array[int],
    # Out:
    alive_out: wp.array[int],
    loss_out: wp.array[wp.float64],
    step_out: wp.array[int],
):
    """Begin every world at the measured start of its window, without a warm start, at time 0."""
    worldid = wp.tid()
    window = world_window_in[worldid]
    for i in range(nq_in):
        qpos_out[worldid, i] = float(state_in[window, 0, i])
    for i in range(nv_in):
        qvel_out[worldid, i] = float(state_in[window, 0, nq_in + i])
        qacc_warmstart_out[worldid, i] = 0.0
        qfrc_applied_out[worldid, i] = 0.0
    time_out[worldid] = 0.0
    overflow_out[worldid] = 0
    alive_out[worldid] = 1
    loss_out[worldid] = wp.float64(0.0)
    if worldid == 0:
        step_out[0] = 0


@wp.kernel(enable_backward=False)
def _set_state(
    # In:
    state_in: wp.array3d[float],
    nq_in: int,
    # Data out:
    qpos_out: wp.array2d[float],
    qvel_out: wp.array2d[float],
):
    """Begin at the first of a world's states."""
    worldid, i = wp.tid()
    if i < nq_in:
        qpos_out[worldid, i] = state_in[worldid, 0, i]
    else:
        qvel_out[worldid, i - nq_in] = state_in[worldid, 0, i]


@wp.kernel(enable_backward=False)
def _set_ctrl(
    # In:
    ctrl_in: wp.array3d[float],
    world_window_in: wp.array[int],
    step_in: wp.array[int],
    nhistory_in: int,
    # Data out:
    ctrl_out: wp.array2d[float],
):
    """Send the recorded command of this control step; the first `nhistory` ones lie before the start."""
    worldid, i = wp.tid()
    ctrl_out[worldid, i] = ctrl_in[world_window_in[worldid], nhistory_in + step_in[0], i]


@wp.kernel(enable_backward=False)
def _set_signal(
    # In:
    ctrl_in: wp.array3d[float],
    world_window_in: wp.array[int],
    nsub_in: int,
    # Out:
    signal_out: wp.array3d[float],
):
    """Lay out the recorded commands by physics steps, those before the start included."""
    worldid, s, i = wp.tid()
    signal_out[worldid, s, i] = ctrl_in[world_window_in[worldid], s // nsub_in, i]


@wp.kernel(enable_backward=False)
def _send_signal(
    # In:
    signal_in: wp.array3d[float],
    step_in: wp.array[int],
    nhistory_in: int,
    nsub_in: int,
    substep_in: int,
    # Data out:
    ctrl_out: wp.array2d[float],
):
    """Send the command that reaches the actuators in this physics step."""
    worldid, i = wp.tid()
    ctrl_out[worldid, i] = signal_in[worldid, (nhistory_in + step_in[0]) * nsub_in + substep_in, i]


@wp.kernel(enable_backward=False)
def _flag_overflow(
    # Data in:
    nefc_in: wp.array[int],
    nacon_in: wp.array[int],
    ncollision_in: wp.array[int],
    njmax_in: int,
    naconmax_in: int,
    # In:
    nefc_bit_in: int,
    ncon_bit_in: int,
    # Data out:
    overflow_out: wp.array[int],
):
    """Note buffers that were too small in any evaluation of the forces, not only in a step's last one."""
    worldid = wp.tid()
    if nefc_in[worldid] > njmax_in:
        overflow_out[worldid] = overflow_out[worldid] | nefc_bit_in
    if nacon_in[0] > naconmax_in or ncollision_in[0] > naconmax_in:
        overflow_out[worldid] = overflow_out[worldid] | ncon_bit_in


@wp.kernel(enable_backward=False)
def _join_overflow(
    # Data in:
    overflow_in: wp.array[int],
    # Out:
    joined_out: wp.array[int],
):
    """All bits of all worlds in one number."""
    worldid = wp.tid()
    if overflow_in[worldid] != 0:
        wp.atomic_or(joined_out, 0, overflow_in[worldid])


@wp.func
def _is_bad(x: float):
    return wp.isnan(x) or wp.abs(x) > MAX_VALUE


@wp.kernel(enable_backward=False)
def _flag_divergence(
    # Model:
    qpos0: wp.array2d[float],
    # Data in:
    qacc_in: wp.array2d[float],
    nq_in: int,
    nv_in: int,
    # Data out:
    qpos_out: wp.array2d[float],
    qvel_out: wp.array2d[float],
    qacc_warmstart_out: wp.array2d[float],
    # Out:
    alive_out: wp.array[int],
):
    """Mark worlds that blew up in this physics step and put them at rest, where they cost the solver least."""
    worldid = wp.tid()
    bad = bool(False)
    for i in range(nq_in):
        bad = bad or _is_bad(qpos_out[worldid, i])
    for i in range(nv_in):
        bad = bad or _is_bad(qvel_out[worldid, i]) or _is_bad(qacc_in[worldid, i])
    if bad:
        alive_out[worldid] = 0
        for i in range(nq_in):
            qpos_out[worldid, i] = qpos0[worldid % qpos0.shape[0], i]
        for i in range(nv_in):
            qvel_out[worldid, i] = 0.0
            qacc_warmstart_out[worldid, i] = 0.0
