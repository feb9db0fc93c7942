"""Constants of the model that follow from its masses, inertias and armatures, for every row of its fields.

They are quadratic forms of the inverse of the inertia matrix at the reference configuration qpos0, of which
`inverse` (nv, nrow, nv) holds a column by its first index. Rows are worlds of these launches; a field that does not
vary has one, which all of them write alike.
"""

import warp as wp

FREE = wp.constant(0)
"""Types of joints, as in mjtJoint."""
BALL = wp.constant(1)


@wp.kernel(enable_backward=False)
def _set_reference(
    # Model:
    qpos0: wp.array2d[float],
    # Data out:
    qpos_out: wp.array2d[float],
):
    """Put every row into its reference configuration."""
    worldid, i = wp.tid()
    qpos_out[worldid, i] = qpos0[worldid % qpos0.shape[0], i]


@wp.kernel(enable_backward=False)
def _sum_subtree(
    # Model:
    body_subtreenum: wp.array[int],
    body_mass: wp.array2d[float],
    # Out:
    body_subtreemass_out: wp.array2d[float],
):
    """Mass of a body and all that it carries, which are the bodies that follow it."""
    worldid, bodyid = wp.tid()
    mass = float(0.0)
    for i in range(bodyid, bodyid + body_subtreenum[bodyid]):
        mass += body_mass[worldid % body_mass.shape[0], i]
    body_subtreemass_out[worldid % body_subtreemass_out.shape[0], bodyid] = mass


@wp.kernel(enable_backward=False)
def _weigh_dofs(
    # Model:
    dof_jntid: wp.array[int],
    jnt_type: wp.array[int],
    jnt_dofadr: wp.array[int],
    # In:
    inverse_in: wp.array3d[float],
    # Out:
    dof_invweight0_out: wp.array2d[float],
):
    """Diagonal of the inverse; the mean of three where MuJoCo treats degrees of freedom alike."""
    worldid, dofid = wp.tid()
    jntid = dof_jntid[dofid]
    first = int(dofid)
    count = int(1)
    if jnt_type[jntid] == FREE:
        first = dofid - (dofid - jnt_dofadr[jntid]) % 3
        count = 3
    elif jnt_type[jntid] == BALL:
        first = jnt_dofadr[jntid]
        count = 3
    total = float(0.0)
    for i in range(first, first + count):
        total += inverse_in[i, worldid, i]
    dof_invweight0_out[worldid % dof_invweight0_out.shape[0], dofid] = total / float(count)


@wp.func
def _motion_at(cdof: wp.spatial_vector, offset: wp.vec3):
    """How a degree of freedom moves and turns a point that lies so far from the tree's center of mass."""
    turn = wp.spatial_top(cdof)
    return wp.spatial_bottom(cdof) + wp.cross(turn, offset), turn


@wp.kernel(enable_backward=False)
def _weigh_bodies(
    # Model:
    body_parentid: wp.array[int],
    body_rootid: wp.array[int],
    body_weldid: wp.array[int],
    body_dofadr: wp.array[int],
    body_dofnum: wp.array[int],
    dof_parentid: wp.array[int],
    # Data in:
    subtree_com_in: wp.array2d[wp.vec3],
    xipos_in: wp.array2d[wp.vec3],
    cdof_in: wp.array2d[wp.spatial_vector],
    # In:
    inverse_in: wp.array3d[float],
    # Out:
    body_invweight0_out: wp.array2d[wp.vec2],
):
    """Mean diagonal of J M^-1 J^T at the body's center of mass, for translations and for rotations."""
    worldid, bodyid = wp.tid()
    body_invweight0_out[worldid % body_invweight0_out.shape[0], bodyid] = wp.vec2(0.0, 0.0)
    if body_weldid[bodyid] == 0:
        return
    moved = bodyid
    while moved > 0 and body_dofnum[moved] == 0:
        moved = body_parentid[moved]
    if moved == 0:
        return
    offset = xipos_in[worldid, bodyid] - subtree_com_in[worldid, body_rootid[bodyid]]
    last = body_dofadr[moved] + body_dofnum[moved] - 1
    translation = float(0.0)
    rotation = float(0.0)
    i = last
    while i >= 0:
        move, turn = _motion_at(cdof_in[worldid, i], offset)
        j = last
        while j >= 0:
            other_move, other_turn = _motion_at(cdof_in[worldid, j], offset)
            share = inverse_in[i, worldid, j]
            translation += share * wp.dot(move, other_move)
            rotation += share * wp.dot(turn, other_turn)
            j = dof_parentid[j]
        i = dof_parentid[i]
    body_invweight0_out[worldid % body_invweight0_out.shape[0], bodyid] = wp.vec2(translation / 3.0, rotation / 3.0)


@wp.kernel(enable_backward=False)
def _weigh_tendons(
    # Model:
    ten_J_rownnz: wp.array[int],
    ten_J_rowadr: wp.array[int],
    ten_J_colind: wp.array[int],
    # Data in:
    ten_J_in: wp.array2d[float],
    # In:
    inverse_in: wp.array3d[float],
    # Out:
    tendon_invweight0_out: wp.array2d[float],
):
    """J M^-1 J^T of every tendon."""
    worldid, tenid = wp.tid()
    first = ten_J_rowadr[tenid]
    total = float(0.0)
    for a in range(first, first + ten_J_rownnz[tenid]):
        for b in range(first, first + ten_J_rownnz[tenid]):
            share = inverse_in[ten_J_colind[a], worldid, ten_J_colind[b]]
            total += ten_J_in[worldid, a] * share * ten_J_in[worldid, b]
    tendon_invweight0_out[worldid % tendon_invweight0_out.shape[0], tenid] = total


@wp.kernel(enable_backward=False)
def _accelerate_actuators(
    # Data in:
    moment_rownnz_in: wp.array2d[int],
    moment_rowadr_in: wp.array2d[int],
    moment_colind_in: wp.array2d[int],
    actuator_moment_in: wp.array2d[float],
    # In:
    inverse_in: wp.array3d[float],
    # Out:
    actuator_acc0_out: wp.array2d[float],
):
    """Norm of the acceleration that a unit force of every actuator makes."""
    worldid, actid = wp.tid()
    first = moment_rowadr_in[worldid, actid]
    total = float(0.0)
    for dofid in range(inverse_in.shape[0]):
        acceleration = float(0.0)
        for a in range(first, first + moment_rownnz_in[worldid, actid]):
            moment = actuator_moment_in[worldid, a]
            acceleration += inverse_in[dofid, worldid, moment_colind_in[worldid, a]] * moment
        total += acceleration * acceleration
    actuator_acc0_out[worldid % actuator_acc0_out.shape[0], actid] = wp.sqrt(total)
