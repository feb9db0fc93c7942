"""Residuals of control steps, white innovations along a recording, and what whole recordings cost."""

import warp as wp

from nfpde.kernels.loss import _rotation_between


@wp.kernel(enable_backward=False)
def _keep_residual(
    # In:
    predicted_in: wp.array3d[float],
    target_in: wp.array3d[wp.float64],
    scale_in: wp.array[wp.float64],
    quaternion_in: wp.array[int],
    world_window_in: wp.array[int],
    step_in: wp.array[int],
    ndiff_in: int,
    # Out:
    residual_out: wp.array2d[wp.float64],
):
    """Keep (predicted - measured) / scale of all channels of a control step, in double precision.

    `quaternion_in` is 1 in the first column of each quaternion in the state, whose four numbers make three channels.
    The numbers of step h stand from column h * ndiff on.
    """
    worldid = wp.tid()
    window = world_window_in[worldid]
    h = step_in[0] + 1
    k = wp.min(step_in[0], predicted_in.shape[1] - 1)
    channel = step_in[0] * ndiff_in
    column = int(0)
    # one step more than the window has is taken before the control step is captured
    if channel < residual_out.shape[1]:
        while column < predicted_in.shape[2]:
            if quaternion_in[column] == 1:
                measured = wp.vec4d()
                predicted = wp.vec4d()
                for i in range(4):
                    measured[i] = target_in[window, h, column + i]
                    predicted[i] = wp.float64(predicted_in[worldid, k, column + i])
                turn = _rotation_between(measured, predicted)
                for i in range(3):
                    residual_out[worldid, channel + i] = turn[i] / scale_in[channel + i]
                column += 4
                channel += 3
            else:
                difference = wp.float64(predicted_in[worldid, k, column]) - target_in[window, h, column]
                residual_out[worldid, channel] = difference / scale_in[channel]
                column += 1
                channel += 1


@wp.kernel(enable_backward=False)
def _whiten_alone(
    # In:
    residual_in: wp.array2d[wp.float64],
    own_in: wp.array3d[wp.float64],
    window_in: wp.array[int],
    # Out:
    white_out: wp.array2d[wp.float64],
):
    """Multiply each row by its window's own matrix, as if no other window shared a state with it."""
    row, i = wp.tid()
    matrix = window_in[row] % own_in.shape[0]
    total = wp.float64(0.0)
    for j in range(residual_in.shape[1]):
        total += own_in[matrix, i, j] * residual_in[row, j]
    white_out[row, i] = total


@wp.func
def _log_of_one_plus(x: wp.float64):
    """log(1 + x) without loss of a small x (Kahan)."""
    u = wp.float64(1.0) + x
    if u == wp.float64(1.0):
        return x
    return wp.log(u) * x / (u - wp.float64(1.0))


@wp.kernel(enable_backward=False)
def _sum_costs(
    # In:
    carry_in: wp.array3d[wp.float64],
    linked_in: wp.array[int],
    window_in: wp.array[int],
    first_in: wp.array[int],
    before_in: wp.array[wp.float64],
    continues_in: int,
    degrees_in: wp.float64,
    diverged_in: wp.float64,
    # Out:
    white_out: wp.array2d[wp.float64],
    cost_out: wp.array[wp.float64],
):
    """Take from each row what the innovation before it tells, and add up a recording's Student t costs.

    Recording k has the rows first[k] to first[k + 1] - 1, in recorded order, with the parameters of one vector. The
    first row of all may go on from `before`, where its recording began in an earlier batch.
    """
    chain = wp.tid()
    channels = white_out.shape[1]
    total = wp.float64(0.0)
    for row in range(first_in[chain], first_in[chain + 1]):
        window = window_in[row]
        matrix = window % carry_in.shape[0]
        earlier = row > first_in[chain]
        square = wp.float64(0.0)
        for i in range(channels):
            value = white_out[row, i]
            if linked_in[window] == 1 and (earlier or (row == 0 and continues_in == 1)):
                for j in range(channels):
                    told = wp.float64(0.0)
                    if earlier:
                        told = white_out[row - 1, j]
                    else:
                        told = before_in[j]
                    if wp.isfinite(told):
                        value -= carry_in[matrix, i, j] * told
            white_out[row, i] = value
            square += value * value
        if not (square < diverged_in):
            square = diverged_in
        total += (degrees_in + wp.float64(channels)) * _log_of_one_plus(square / degrees_in)
    cost_out[chain] = total
