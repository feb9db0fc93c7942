"""Actuators on a hinge or slide: what torque they give, and effects that follow from it.

Fields of the model come as (rows, numbers) of floats: `gainprm` and `biasprm` have 10 numbers for each actuator,
`gear` 6, ranges 2. What does not differ between worlds comes by element of the effect.
"""

import warp as wp


@wp.func
def _own(field: wp.array2d[float], worldid: int, k: int):
    """A number of a field that has fewer rows than there are worlds."""
    return field[worldid % field.shape[0], k]


@wp.func
def _drive_torque(
    worldid: int,
    actuatorid: int,
    jntid: int,
    ctrl: float,
    position: float,
    speed: float,
    kind: int,
    gear_in: wp.array2d[float],
    gainprm_in: wp.array2d[float],
    biasprm_in: wp.array2d[float],
    forcerange_in: wp.array2d[float],
    actfrcrange_in: wp.array2d[float],
):
    """Torque at the joint in the next physics step.

    `kind` has bits: 1 affine gain, 2 affine bias, 4 limited force, 8 limited force of the joint, 16 disabled.
    """
    if kind & 16 != 0:
        return float(0.0)
    gear = _own(gear_in, worldid, 6 * actuatorid)
    length = gear * position
    velocity = gear * speed
    k = 10 * actuatorid
    gain = _own(gainprm_in, worldid, k)
    if kind & 1 != 0:
        gain += _own(gainprm_in, worldid, k + 1) * length + _own(gainprm_in, worldid, k + 2) * velocity
    force = gain * ctrl
    if kind & 2 != 0:
        force += _own(biasprm_in, worldid, k)
        force += _own(biasprm_in, worldid, k + 1) * length + _own(biasprm_in, worldid, k + 2) * velocity
    if kind & 4 != 0:
        force = wp.clamp(
            force, _own(forcerange_in, worldid, 2 * actuatorid), _own(forcerange_in, worldid, 2 * actuatorid + 1)
        )
    torque = gear * force
    if kind & 8 != 0:
        torque = wp.clamp(
            torque, _own(actfrcrange_in, worldid, 2 * jntid), _own(actfrcrange_in, worldid, 2 * jntid + 1)
        )
    return torque


@wp.kernel(enable_backward=False)
def _limit_torque_by_speed(
    # Data in:
    qvel_in: wp.array2d[float],
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    jntid_in: wp.array[int],
    dofid_in: wp.array[int],
    first_in: int,
    effect_in: int,
    # Out:
    jnt_actfrcrange_out: wp.array2d[float],
):
    """Torque-speed line: with the motion at most stall (1 - |speed| / no-load speed), against it up to stall.

    Several actuators of one joint come as one element each, and tighten its range to the same numbers.
    """
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    top = float(values_in[row, first_in])
    stall = float(values_in[row, first_in + 1])
    speed = qvel_in[worldid, dofid_in[i]]
    most = stall * wp.max(1.0 - wp.max(speed, 0.0) / top, 0.0)
    least = -stall * wp.max(1.0 + wp.min(speed, 0.0) / top, 0.0)
    k = 2 * jntid_in[i]
    jnt_actfrcrange_out[worldid, k] = wp.max(jnt_actfrcrange_out[worldid, k], least)
    jnt_actfrcrange_out[worldid, k + 1] = wp.min(jnt_actfrcrange_out[worldid, k + 1], most)


@wp.kernel(enable_backward=False)
def _add_load_friction(
    # Model:
    actuator_gear: wp.array2d[float],
    actuator_gainprm: wp.array2d[float],
    actuator_biasprm: wp.array2d[float],
    actuator_forcerange: wp.array2d[float],
    jnt_actfrcrange: wp.array2d[float],
    # Data in:
    ctrl_in: wp.array2d[float],
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # In:
    values_in: wp.array2d[wp.float64],
    active_in: wp.array2d[int],
    world_row_in: wp.array[int],
    dofid_in: wp.array[int],
    actuatorid_in: wp.array[int],
    jntid_in: wp.array[int],
    qposid_in: wp.array[int],
    driven_dofid_in: wp.array[int],
    ctrlid_in: wp.array[int],
    kind_in: wp.array[int],
    low_in: wp.array[float],
    high_in: wp.array[float],
    first_in: int,
    effect_in: int,
    # Out:
    dof_frictionloss_out: wp.array2d[float],
):
    """Load friction: add base + share |torque that the actuators transmit to the joint| to its friction loss.

    A limit of the joint is one of their sum.
    """
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    dofid = dofid_in[i]
    torque = float(0.0)
    limited = int(-1)
    for a in range(actuatorid_in.shape[0]):
        if driven_dofid_in[a] == dofid:
            torque += _drive_torque(
                worldid,
                actuatorid_in[a],
                jntid_in[a],
                wp.clamp(ctrl_in[worldid, ctrlid_in[a]], low_in[a], high_in[a]),
                qpos_in[worldid, qposid_in[a]],
                qvel_in[worldid, dofid],
                kind_in[a] & ~8,
                actuator_gear,
                actuator_gainprm,
                actuator_biasprm,
                actuator_forcerange,
                jnt_actfrcrange,
            )
            if kind_in[a] & 8 != 0:
                limited = jntid_in[a]
    if limited >= 0:
        torque = wp.clamp(
            torque, _own(jnt_actfrcrange, worldid, 2 * limited), _own(jnt_actfrcrange, worldid, 2 * limited + 1)
        )
    base = float(values_in[row, first_in])
    share = float(values_in[row, first_in + 1])
    dof_frictionloss_out[worldid, dofid] += base + share * wp.abs(torque)


@wp.kernel(enable_backward=False)
def _widen_error(
    # Model:
    actuator_gear: wp.array2d[float],
    actuator_gainprm: wp.array2d[float],
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
    actuator_biasprm_out: wp.array2d[float],
):
    """Dead zone of position servos: what the middle of the error would give is taken off the bias.

    Gain times error is what the servo makes of its reading, which effects of encoders have changed in the bias.
    """
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    actuatorid = actuatorid_in[i]
    k = 10 * actuatorid
    sent = wp.clamp(ctrl_in[worldid, ctrlid_in[i]], low_in[i], high_in[i])
    length = _own(actuator_gear, worldid, 6 * actuatorid) * qpos_in[worldid, qposid_in[i]]
    gain = _own(actuator_gainprm, worldid, k)
    force = gain * sent + actuator_biasprm_out[worldid, k] + actuator_biasprm_out[worldid, k + 1] * length
    most = wp.abs(gain) * float(values_in[row, first_in])
    actuator_biasprm_out[worldid, k] -= wp.clamp(force, -most, most)


@wp.kernel(enable_backward=False)
def _cut_commands(
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
    """Dead zone of motors: take the middle out of the commands, as they are clamped."""
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    half = float(values_in[row, first_in])
    ctrlid = ctrlid_in[i]
    for s in range(signal_out.shape[1]):
        sent = wp.clamp(signal_out[worldid, s, ctrlid], low_in[i], high_in[i])
        signal_out[worldid, s, ctrlid] = sent - wp.clamp(sent, -half, half)
