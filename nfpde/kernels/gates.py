"""Dead zones that give nothing within, and all beyond."""

import warp as wp

from nfpde.kernels.drives import _own


@wp.kernel(enable_backward=False)
def _gate_commands(
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    ctrlid_in: wp.array[int],
    low_in: wp.array[float],
    high_in: wp.array[float],
    first_in: int,
    effect_in: int,
    timestep_in: wp.float64,
    # Out:
    signal_out: wp.array3d[float],
):
    """Dead zone of motors, as a gate: take out small commands, as they are clamped."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    half = float(values_in[row, first_in])
    ctrlid = ctrlid_in[i]
    for s in range(signal_out.shape[1]):
        sent = wp.clamp(signal_out[worldid, s, ctrlid], low_in[i], high_in[i])
        signal_out[worldid, s, ctrlid] = wp.where(wp.abs(sent) <= half, 0.0, sent)


@wp.kernel(enable_backward=False)
def _switch_servos(
    # Model:
    actuator_gear: wp.array2d[float],
    # Data in:
    ctrl_in: wp.array2d[float],
    qpos_in: wp.array2d[float],
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    actuatorid_in: wp.array[int],
    qposid_in: wp.array[int],
    ctrlid_in: wp.array[int],
    low_in: wp.array[float],
    high_in: wp.array[float],
    first_in: int,
    effect_in: int,
    # Out:
    actuator_gainprm_out: wp.array2d[float],
    actuator_biasprm_out: wp.array2d[float],
):
    """Dead zone of position servos, as a gate: those whose errors are small give nothing."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    actuatorid = actuatorid_in[i]
    k = 10 * actuatorid
    sent = wp.clamp(ctrl_in[worldid, ctrlid_in[i]], low_in[i], high_in[i])
    length = _own(actuator_gear, worldid, 6 * actuatorid) * qpos_in[worldid, qposid_in[i]]
    gain = actuator_gainprm_out[worldid, k]
    force = gain * sent + actuator_biasprm_out[worldid, k] + actuator_biasprm_out[worldid, k + 1] * length
    if wp.abs(force) <= wp.abs(gain) * float(values_in[row, first_in]):
        for j in range(10):
            actuator_gainprm_out[worldid, k + j] = 0.0
            actuator_biasprm_out[worldid, k + j] = 0.0
