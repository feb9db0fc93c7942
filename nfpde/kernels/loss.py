"""What comes of a control step: the predicted state, and its squared distance from the measured one."""

import warp as wp


@wp.kernel(enable_backward=False)
def _store_prediction(
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # In:
    alive_in: wp.array[int],
    step_in: wp.array[int],
    nq_in: int,
    # Out:
    predicted_out: wp.array3d[float],
):
    """Keep the state at the end of a control step; NaN once the world has diverged.

    With room for a single state, each one takes the place of the one before.
    """
    worldid, i = wp.tid()
    h = wp.min(step_in[0], predicted_out.shape[1] - 1)
    value = wp.nan
    if alive_in[worldid] == 1:
        if i < nq_in:
            value = qpos_in[worldid, i]
        else:
            value = qvel_in[worldid, i - nq_in]
    predicted_out[worldid, h, i] = value


@wp.func
def _whitened_square(difference: wp.float64, scale: wp.float64):
    return (difference / scale) * (difference / scale)


@wp.func
def _unit_quaternion(q: wp.vec4d):
    return q / wp.sqrt(wp.dot(q, q))


@wp.func
def _rotation_between(measured: wp.vec4d, predicted: wp.vec4d):
    """Rotation vector from one (w, x, y, z) to the other, in the body's frame, the short way round."""
    a = _unit_quaternion(measured)
    b = _unit_quaternion(predicted)
    av = wp.vec3d(a[1], a[2], a[3])
    bv = wp.vec3d(b[1], b[2], b[3])
    scalar = wp.dot(a, b)
    vector = a[0] * bv - b[0] * av - wp.cross(av, bv)
    sine = wp.sqrt(wp.dot(vector, vector))
    ratio = wp.float64(2.0)
    if sine > wp.float64(1.0e-12):
        ratio = wp.float64(2.0) * wp.atan2(sine, wp.abs(scalar)) / sine
    if scalar < wp.float64(0.0):
        ratio = -ratio
    return ratio * vector


@wp.kernel(enable_backward=False)
def _add_loss(
    # In:
    predicted_in: wp.array3d[float],
    target_in: wp.array3d[wp.float64],
    scale_in: wp.array[wp.float64],
    quaternion_in: wp.array[int],
    world_window_in: wp.array[int],
    step_in: wp.array[int],
    # Out:
    loss_out: wp.array[wp.float64],
):
    """Add a control step's sum over channels of ((predicted - measured) / scale)^2.

    `quaternion_in` is 1 in the first column of each quaternion in the state, whose four numbers make three channels.
    In double precision, because the difference of two nearly equal numbers is taken.
    """
    worldid = wp.tid()
    window = world_window_in[worldid]
    h = step_in[0] + 1
    k = wp.min(step_in[0], predicted_in.shape[1] - 1)
    total = wp.float64(0.0)
    column = int(0)
    channel = int(0)
    while column < predicted_in.shape[2]:
        if quaternion_in[column] == 1:
            measured = wp.vec4d()
            predicted = wp.vec4d()
            for i in range(4):
                measured[i] = target_in[window, h, column + i]
                predicted[i] = wp.float64(predicted_in[worldid, k, column + i])
            turn = _rotation_between(measured, predicted)
            for i in range(3):
                total += _whitened_square(turn[i], scale_in[channel + i])
            column += 4
            channel += 3
        else:
            difference = wp.float64(predicted_in[worldid, k, column]) - target_in[window, h, column]
            total += _whitened_square(difference, scale_in[channel])
            column += 1
            channel += 1
    loss_out[worldid] = loss_out[worldid] + total


@wp.kernel(enable_backward=False)
def _count_step(
    # Out:
    step_out: wp.array[int],
):
    """One more control step is done."""
    step_out[0] = step_out[0] + 1


@wp.kernel(enable_backward=False)
def _limit_loss(
    # In:
    alive_in: wp.array[int],
    limit_in: wp.float64,
    # Out:
    loss_out: wp.array[wp.float64],
):
    """Put the limit where a loss is no number or above it, and where the world diverged."""
    worldid = wp.tid()
    if alive_in[worldid] == 0 or not (loss_out[worldid] < limit_in):
        loss_out[worldid] = limit_in
