"""What sensors report of a state, and the state behind a report, in one place of the predicted states.

`direction` is 1 from the simulated state to the measured one, -1 back.
"""

import warp as wp


@wp.kernel(enable_backward=False)
def _offset_positions(
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    qposid_in: wp.array[int],
    dofid_in: wp.array[int],
    first_in: int,
    step_in: wp.array[int],
    nq_in: int,
    direction_in: int,
    # Out:
    state_out: wp.array3d[float],
):
    """Joint offset: the measured position is the true one plus a constant."""
    worldid, i = wp.tid()
    h = wp.min(step_in[0], state_out.shape[1] - 1)
    offset = float(values_in[world_row_in[worldid], first_in])
    state_out[worldid, h, qposid_in[i]] += float(direction_in) * offset


@wp.kernel(enable_backward=False)
def _scale_numbers(
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    numberid_in: wp.array[int],
    first_in: int,
    step_in: wp.array[int],
    nq_in: int,
    direction_in: int,
    # Out:
    state_out: wp.array3d[float],
):
    """Sensor scale, or time scale of speeds: what is measured is the true one times a factor."""
    worldid, i = wp.tid()
    h = wp.min(step_in[0], state_out.shape[1] - 1)
    scale = float(values_in[world_row_in[worldid], first_in])
    if direction_in < 0:
        scale = 1.0 / scale
    state_out[worldid, h, numberid_in[i]] = scale * state_out[worldid, h, numberid_in[i]]
