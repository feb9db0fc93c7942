"""Play between an actuator's rotor and its joint."""

import warp as wp

from nfpde.kernels.drives import _drive_torque, _own


@wp.kernel(enable_backward=False)
def _forget(
    # Out:
    memory_out: wp.array3d[float],
):
    """What an effect kept of an earlier window is unknown at the start of the next."""
    worldid, i, k = wp.tid()
    memory_out[worldid, i, k] = wp.nan


@wp.func
def _resisting(speed: float, drag: float, friction: float, per_torque: float):
    """Torque against a motion; friction gives way to rest within the speed that it takes in a step."""
    stopped = friction * per_torque
    share = float(0.0)
    if stopped > 0.0:
        share = wp.clamp(speed / stopped, -1.0, 1.0)
    return drag * speed + friction * share


@wp.kernel(enable_backward=False)
def _play_rotors(
    # Model:
    opt_timestep: wp.array2d[float],
    actuator_gear: wp.array2d[float],
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
    actuatorid_in: wp.array[int],
    jntid_in: wp.array[int],
    qposid_in: wp.array[int],
    dofid_in: wp.array[int],
    ctrlid_in: wp.array[int],
    kind_in: wp.array[int],
    low_in: wp.array[float],
    high_in: wp.array[float],
    spare_in: wp.array[float],
    traits_in: wp.array[int],
    first_in: int,
    effect_in: int,
    # Out:
    memory_out: wp.array3d[float],
    actuator_gainprm_out: wp.array2d[float],
    actuator_biasprm_out: wp.array2d[float],
    dof_armature_out: wp.array2d[float],
    dof_damping_out: wp.array2d[float],
    dof_frictionloss_out: wp.array2d[float],
    qfrc_applied_out: wp.array2d[float],
):
    """Backlash: couple or uncouple the rotors for this step, and move those that are free to its end.

    Of the bits of `traits`, 1 puts the joint's damping and friction on the rotor, 2 the servo's encoder on the joint.

    `memory` holds for each rotor the end of the play it is at (+1 or -1, 0 in between), its position and speed as seen
    at the joint, and the joint's speed one step ago; NaN where that is not known.
    """
    worldid, i = wp.tid()
    row = world_row_in[worldid]
    if active_in[row, effect_in] == 0:
        return
    half = 0.5 * float(values_in[row, first_in])
    dt = _own(opt_timestep, worldid, 0)
    a = actuatorid_in[i]
    dofid = dofid_in[i]
    sent = wp.clamp(ctrl_in[worldid, ctrlid_in[i]], low_in[i], high_in[i])
    joint = qpos_in[worldid, qposid_in[i]]
    if wp.isnan(joint):  # before the recording began
        return
    joint_speed = qvel_in[worldid, dofid]
    side = memory_out[worldid, i, 0]
    position = memory_out[worldid, i, 1]
    speed = memory_out[worldid, i, 2]
    before = memory_out[worldid, i, 3]
    inertia = dof_armature_out[worldid, dofid]
    if not inertia > 0.0:
        inertia = spare_in[i]
    drag = float(0.0)
    friction = float(0.0)
    if traits_in[i] & 1 != 0:
        drag = dof_damping_out[worldid, dofid]
        friction = dof_frictionloss_out[worldid, dofid]
    acceleration = float(0.0)
    if not wp.isnan(before):
        acceleration = (joint_speed - before) / dt
    unknown = wp.isnan(side)
    if unknown:  # in the first step, and in the second, which knows the acceleration
        pull = _drive_torque(
            worldid,
            a,
            jntid_in[i],
            sent,
            joint,
            joint_speed,
            kind_in[i],
            actuator_gear,
            actuator_gainprm_out,
            actuator_biasprm_out,
            actuator_forcerange,
            jnt_actfrcrange,
        )
        side = float(1.0)
        if pull - inertia * acceleration - _resisting(joint_speed, drag, friction, dt / inertia) < 0.0:
            side = float(-1.0)

    # free rotors that cross the play nearer to now than to the next step meet the joint, if not on their way back
    met = bool(False)
    if side == 0.0:
        closing = speed - joint_speed
        ahead = position - joint + 0.5 * dt * closing
        if wp.abs(ahead) >= half and ahead * closing >= 0.0:
            met = True
            qfrc_applied_out[worldid, dofid] += inertia * closing / dt
            side = wp.where(ahead > 0.0, 1.0, wp.where(ahead < 0.0, -1.0, 0.0))

    # rotors at an end stay there while the teeth push
    if side != 0.0:
        position = joint + side * half
        speed = joint_speed
    outer = traits_in[i] & 2 != 0
    torque = _drive_torque(
        worldid,
        a,
        jntid_in[i],
        sent,
        wp.where(outer, joint, position),
        wp.where(outer, joint_speed, speed),
        kind_in[i],
        actuator_gear,
        actuator_gainprm_out,
        actuator_biasprm_out,
        actuator_forcerange,
        jnt_actfrcrange,
    )
    lost = inertia * acceleration + _resisting(speed, drag, friction, dt / inertia)
    if not met and side * (torque - lost) < 0.0:
        side = float(0.0)

    # servos measure the rotor; a free rotor neither drives its joint nor loads it
    gear = _own(actuator_gear, worldid, 6 * a)
    k = 10 * a
    stiffness = float(0.0)
    damping = float(0.0)
    if kind_in[i] & 2 != 0 and not outer:
        stiffness = wp.max(-gear * gear * actuator_biasprm_out[worldid, k + 1], 0.0)
        damping = wp.max(-gear * gear * actuator_biasprm_out[worldid, k + 2], 0.0)
        actuator_biasprm_out[worldid, k] += actuator_biasprm_out[worldid, k + 1] * gear * (position - joint)
    if side == 0.0:
        dof_armature_out[worldid, dofid] = 0.0
        if traits_in[i] & 1 != 0:
            dof_damping_out[worldid, dofid] = 0.0
            dof_frictionloss_out[worldid, dofid] = 0.0
        for j in range(10):
            actuator_gainprm_out[worldid, k + j] = 0.0
            actuator_biasprm_out[worldid, k + j] = 0.0
    whole = inertia + dt * (damping + drag + dt * stiffness)
    speed += dt * (torque - drag * speed - dt * stiffness * speed) / whole
    speed -= wp.clamp(speed, -dt * friction / whole, dt * friction / whole)
    if unknown and wp.isnan(before):
        side = wp.nan
    memory_out[worldid, i, 0] = side
    memory_out[worldid, i, 1] = position + dt * speed
    memory_out[worldid, i, 2] = speed
    memory_out[worldid, i, 3] = wp.where(met, wp.nan, joint_speed)
