"""Actuators that act on one hinge or slide, and the torque that MuJoCo will have them give there."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.effects.effect import Array, Rows, World
from nfpde.effects.scales import DataScales
from nfpde.elements import actuator_ctrls, is_axis, joint_dofs, joint_qpos
from nfpde.errors import BadEffect

DRIVE_FIELDS = (
    "actuator_gainprm",
    "actuator_biasprm",
    "actuator_gear",
    "actuator_forcerange",
    "jnt_actfrclimited",
    "jnt_actfrcrange",
)
"""Fields that decide the torque of an actuator: `step_fields` of effects that ask for it."""

_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_GAINS = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
_GROUPS = 31
"""Groups of actuators that can be disabled; those of other numbers cannot."""
_WRAPPED = int(mujoco.mjtWrap.mjWRAP_JOINT)
_MUSCLE = (int(mujoco.mjtGain.mjGAIN_MUSCLE), int(mujoco.mjtBias.mjBIAS_MUSCLE))
_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))


def driven_joint(model: mujoco.MjModel, actuator: int) -> int:
    """The hinge or slide that an actuator acts on, or -1 where it acts on anything else."""
    if not 0 <= actuator < model.nactuator or int(model.actuator_trntype[actuator]) not in _JOINT:
        return -1
    joint = int(model.actuator_trnid[actuator, 0])
    return joint if is_axis(model, joint) else -1


def driven_joints(model: mujoco.MjModel, actuators: Rows, where: str) -> Rows:
    """The hinges and slides that actuators act on, one for each.

    Raises:
        BadEffect: an actuator that acts on anything else.
    """
    joints = np.array([driven_joint(model, int(i)) for i in actuators], dtype=np.intp)
    if (joints < 0).any():
        raise BadEffect(f"{where}: it needs actuators that act on a hinge or a slide")
    return joints


def torque_scales(model: mujoco.MjModel, actuator: int, scales: DataScales) -> tuple[float, float]:
    """Typical and largest torque [Nm or N] at the joint that an actuator drives."""
    gear = abs(float(model.actuator_gear[actuator, 0]))
    return float(scales.actuator_force[actuator]) * gear, float(scales.actuator_peak[actuator]) * gear


def is_plain(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator drives a hinge or slide with one command, without a state, by fixed or affine gain and bias.

    Those are motors, and position and velocity servos; a plugin has such fields too, and does not look at them.
    """
    return (
        driven_joint(model, actuator) >= 0
        and int(model.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_NONE)
        and int(model.actuator_ctrlnum[actuator]) == 1
        and int(model.actuator_gaintype[actuator]) in _GAINS
        and int(model.actuator_biastype[actuator]) in _BIASES
        and int(model.actuator_plugin[actuator]) < 0
    )


def is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether a plain actuator's force depends on the position, and its gain does not: a position servo."""
    return is_plain(model, actuator) and _feeds_back(model, actuator) and model.actuator_biasprm[actuator, 1] != 0


def is_speed_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether a plain actuator's force depends on the speed and not on the position: a velocity servo."""
    speed, position = model.actuator_biasprm[actuator, 2], model.actuator_biasprm[actuator, 1]
    return is_plain(model, actuator) and _feeds_back(model, actuator) and position == 0 and speed != 0


def _feeds_back(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator has a fixed gain and an affine bias, as servos have."""
    gain, bias = int(model.actuator_gaintype[actuator]), int(model.actuator_biastype[actuator])
    return gain == int(mujoco.mjtGain.mjGAIN_FIXED) and bias == int(mujoco.mjtBias.mjBIAS_AFFINE)


def servos_on(model: mujoco.MjModel, joints: Rows) -> Rows:
    """Position and velocity servos, which read the sensors of these joints, by actuator id."""
    of_joints = [i for i in range(model.nactuator) if driven_joint(model, i) in joints]
    return np.array([i for i in of_joints if is_servo(model, i) or is_speed_servo(model, i)], dtype=np.intp)


def unread_on(model: mujoco.MjModel, joints: Rows) -> list[int]:
    """Actuators that may read the sensors of these joints as well, in a way that is not known here, by id.

    Those are whatever is no `servos_on` and whose force follows the position or speed of a joint, or of a tendon that
    is made of joints. The force of a muscle follows its own length, which no encoder has a part in.
    """
    known = set(servos_on(model, joints).tolist())
    return [i for i in range(model.nactuator) if i not in known and _acts_on(model, i, joints) and _follows(model, i)]


def _acts_on(model: mujoco.MjModel, actuator: int, joints: Rows) -> bool:
    """Whether an actuator drives one of these joints, by itself or through a tendon that is made of joints."""
    if int(model.actuator_trntype[actuator]) != int(mujoco.mjtTrn.mjTRN_TENDON):
        return driven_joint(model, actuator) in joints
    tendon = int(model.actuator_trnid[actuator, 0])
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    wraps = range(first, first + count)
    return any(int(model.wrap_type[w]) == _WRAPPED and int(model.wrap_objid[w]) in joints for w in wraps)


def _follows(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator's force depends on its position or speed."""
    gain, bias = int(model.actuator_gaintype[actuator]), int(model.actuator_biastype[actuator])
    plain = gain in (*_GAINS, _MUSCLE[0]) and bias in (*_BIASES, _MUSCLE[1])
    if not plain or int(model.actuator_plugin[actuator]) >= 0:
        return True
    by_gain = gain == _GAINS[1] and model.actuator_gainprm[actuator, 1:3].any()
    return bool(by_gain or (bias == _BIASES[1] and model.actuator_biasprm[actuator, 1:3].any()))


def refuse_unread(model: mujoco.MjModel, joints: Rows, where: str, instead: str) -> None:
    """Refuse an effect on what servos read, at joints where something may read the sensor that is no servo known here.

    Raises:
        BadEffect: the actuator, and what to use instead.
    """
    unread = unread_on(model, joints)
    if unread:
        raise BadEffect(
            f"{where}: actuator #{unread[0]} follows the position or speed of this joint, and is no position or "
            f"velocity servo with gains of its own: what its force becomes with another reading is not known. Use "
            f"{instead}, where the recording alone is wrong, or make the actuator a <position> or <velocity> one"
        )


def switched_off(model: mujoco.MjModel, actuators: Rows) -> NDArray[np.bool_]:
    """Which actuators the model's options disable, with their group or with all others, (k,)."""
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION):
        return np.ones(len(actuators), dtype=bool)
    groups = model.actuator_group[actuators]
    known = (groups >= 0) & (groups < _GROUPS)
    return known & ((int(model.opt.disableactuator) >> np.clip(groups, 0, _GROUPS - 1)) & 1).astype(bool)


def clamped(model: mujoco.MjModel, ctrls: Rows, ctrl: Array) -> Array:
    """Commands (..., k), of ids `ctrls` (k,), within the range that MuJoCo clamps them to."""
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL):
        return ctrl
    low, high = model.actuator_ctrlrange[ctrls].T
    return np.where(model.actuator_ctrllimited[ctrls].astype(bool), np.clip(ctrl, low, high), ctrl)


@dataclass(frozen=True, eq=False)
class Drives:
    """Plain actuators, and where their joints stand in the state; each (k,)."""

    ids: Rows
    joints: Rows
    dofs: Rows
    qposadr: Rows
    ctrls: Rows

    @classmethod
    def of(cls, model: mujoco.MjModel, ids: Rows, where: str) -> Drives:
        """Of actuator ids.

        Raises:
            BadEffect: one of them is no motor or servo on a hinge or slide.
        """
        for i in ids:
            if not is_plain(model, int(i)):
                raise BadEffect(
                    f"{where}: actuator #{i} is no motor, position servo or velocity servo on a hinge or slide; "
                    "target one that is"
                )
        joints = np.array([driven_joint(model, int(i)) for i in ids], dtype=np.intp)
        if not len(ids):
            return cls(joints, joints, joints, joints, joints)
        return cls(ids, joints, joint_dofs(model, joints), joint_qpos(model, joints), actuator_ctrls(model, ids))

    def clamped(self, model: mujoco.MjModel, ctrl: Array) -> Array:
        """Their commands (..., k) within the range that MuJoCo clamps them to."""
        return clamped(model, self.ctrls, ctrl)

    def field(self, world: World, name: str, rows: Rows) -> Array:
        """A field of `DRIVE_FIELDS`, of these rows and actuators or their joints, (n, k, ...)."""
        return world.fields[name][np.ix_(rows, self.joints if name.startswith("jnt") else self.ids)]

    def torque(self, world: World, rows: Rows, position: Array | None = None, speed: Array | None = None) -> Array:
        """Torque at the joint [Nm or N] in the next physics step, (n, k), of each actuator as if it were alone there.

        Args:
            world: with `DRIVE_FIELDS`.
            rows: of the world (n,).
            position: of the joint as the actuator sees it (n, k); the joint's own if not given.
            speed: of the joint as the actuator sees it (n, k); the joint's own if not given.
        """
        return self._at_joints(world, rows, self._unlimited(world, rows, position, speed), self.joints)

    def torque_together(self, world: World, rows: Rows, joints: Rows) -> Array:
        """Torque that they bring to hinges and slides `joints` (m,) together [Nm or N], (n, m).

        A joint's limit is one of the sum, as MuJoCo has it.
        """
        parts = self._unlimited(world, rows)
        torque = np.zeros((len(rows), len(joints)))
        places = {int(j): i for i, j in enumerate(joints)}
        for i, joint in enumerate(self.joints):
            torque[:, places[int(joint)]] += parts[:, i]
        return self._at_joints(world, rows, torque, joints)

    def _at_joints(self, world: World, rows: Rows, torque: Array, joints: Rows) -> Array:
        """Torques (n, m) within the limits of the joints."""
        cell = np.ix_(rows, joints)
        limited = world.fields["jnt_actfrclimited"][cell].astype(bool)
        return _limited(torque, world.fields["jnt_actfrcrange"][cell], limited)

    def _unlimited(self, world: World, rows: Rows, position: Array | None = None, speed: Array | None = None) -> Array:
        """As `torque`, before the limit of the joint."""
        model = world.model
        gear = self.field(world, "actuator_gear", rows)[..., 0]
        length = gear * (world.qpos[np.ix_(rows, self.qposadr)] if position is None else position)
        velocity = gear * (world.qvel[np.ix_(rows, self.dofs)] if speed is None else speed)
        ctrl = self.clamped(model, world.ctrl[np.ix_(rows, self.ctrls)])
        gain, bias = (self.field(world, f"actuator_{f}prm", rows) for f in ("gain", "bias"))
        affine_gain = model.actuator_gaintype[self.ids] == int(mujoco.mjtGain.mjGAIN_AFFINE)
        affine_bias = model.actuator_biastype[self.ids] == int(mujoco.mjtBias.mjBIAS_AFFINE)
        force = ctrl * (gain[..., 0] + affine_gain * (gain[..., 1] * length + gain[..., 2] * velocity))
        force = force + affine_bias * (bias[..., 0] + bias[..., 1] * length + bias[..., 2] * velocity)
        limits = self.field(world, "actuator_forcerange", rows)
        force = _limited(force, limits, model.actuator_forcelimited[self.ids].astype(bool))
        return np.where(switched_off(model, self.ids), 0.0, gear * force)


def _limited(force: Array, limits: Array, where: NDArray[np.bool_]) -> Array:
    return np.where(where, np.clip(force, limits[..., 0], limits[..., 1]), force)
