"""Effects on the way from the recorded commands to the actuators, one kernel each.

All have the same arguments, but for what they get of each element. `signal` holds the commands of every physics step,
those before the window's start included, and is changed in place, by one thread for each world and command.
"""

import warp as wp


@wp.kernel(enable_backward=False)
def _delay_commands(
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
    """Actuation delay: shift by whole steps, and average the two commands that a physics step overlaps, clamped."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    ctrlid = ctrlid_in[i]
    late = values_in[row, first_in] / timestep_in
    whole = int(wp.floor(late + wp.float64(1.0e-9)))
    share = float(late - wp.float64(whole))
    if share < 1.0e-9:  # a whole number of steps but for rounding: a plain shift
        share = 0.0
    # from the last step to the first, so that what is read has not been written yet
    s = int(signal_out.shape[1] - 1)
    while s >= 0:
        newer = wp.clamp(signal_out[worldid, wp.max(s - whole, 0), ctrlid], low_in[i], high_in[i])
        older = wp.clamp(signal_out[worldid, wp.max(s - whole - 1, 0), ctrlid], low_in[i], high_in[i])
        signal_out[worldid, s, ctrlid] = (1.0 - share) * newer + share * older
        s -= 1


@wp.kernel(enable_backward=False)
def _offset_commands(
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    ctrlid_in: wp.array[int],
    first_in: int,
    effect_in: int,
    timestep_in: wp.float64,
    # Out:
    signal_out: wp.array3d[float],
):
    """Actuator bias: add a constant."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    offset = float(values_in[row, first_in])
    for s in range(signal_out.shape[1]):
        signal_out[worldid, s, ctrlid_in[i]] += offset


@wp.kernel(enable_backward=False)
def _lag_commands(
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
    """Actuator lag: a first-order filter of clamped commands, constant in a step, solved exactly, by its mean."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    ctrlid = ctrlid_in[i]
    steps = timestep_in / wp.max(values_in[row, first_in], wp.float64(1.0e-300))
    kept = wp.exp(-steps)
    mean = (wp.float64(1.0) - kept) / steps
    y = wp.float64(wp.clamp(signal_out[worldid, 0, ctrlid], low_in[i], high_in[i]))
    for s in range(signal_out.shape[1]):
        u = wp.float64(wp.clamp(signal_out[worldid, s, ctrlid], low_in[i], high_in[i]))
        signal_out[worldid, s, ctrlid] = wp.float32(u + (y - u) * mean)
        y = u + (y - u) * kept


@wp.kernel(enable_backward=False)
def _play_commands(
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    ctrlid_in: wp.array[int],
    low_in: wp.array[float],
    high_in: wp.array[float],
    gear_in: wp.array[float],
    first_in: int,
    effect_in: int,
    timestep_in: wp.float64,
    # Out:
    signal_out: wp.array3d[float],
):
    """Backlash of a servo's command: its aim stays within half the width of it."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    half = 0.5 * float(values_in[row, first_in]) * gear_in[i]
    ctrlid = ctrlid_in[i]
    aim = wp.clamp(signal_out[worldid, 0, ctrlid], low_in[i], high_in[i])
    for s in range(signal_out.shape[1]):
        sent = wp.clamp(signal_out[worldid, s, ctrlid], low_in[i], high_in[i])
        aim = wp.clamp(aim, sent - half, sent + half)
        signal_out[worldid, s, ctrlid] = aim
