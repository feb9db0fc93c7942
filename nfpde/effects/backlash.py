"""Play between an actuator and its joint."""

from __future__ import annotations

import math
from typing import ClassVar, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.effects.drive import DRIVE_FIELDS, Drives, is_plain, is_servo, is_speed_servo
from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows, World
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.errors import BadEffect

_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)

_RECALL = 0.2
"""Time [s] in which a rotor meets an end of its play, whatever it did before: it falls across in some hundredths."""

_ROTOR = 0.1
"""Share of a joint's inertia that its rotor is taken to have where the model gives no armature."""


@register
class Backlash(Effect):
    """A rotor that can turn by `width` before it meets the joint.

    The rotor's inertia J is the joint's armature, or a tenth of the joint's inertia in the model's initial pose where
    it has none. At an end of the play the joint moves as without backlash, until the torque that the teeth transmit,
    torque - J acceleration, pulls away. Then the joint moves without the torque and without its armature, and the
    rotor by the torque alone, until it has crossed the play or the joint has caught up; they go on together, with the
    momentum of both (an impulse of J times the difference of their speeds, in one physics step). A servo measures
    the rotor, which is integrated implicitly in the servo's gains: they may be too stiff for it, not for the joint.

    What resists the joint's motion, its damping and friction, sits behind the play, at the joint: see `backlash_geared`
    for the rotor's side, and `backlash_outer` for servos that measure the joint.

    No recording says where in the play a window starts: the rotor is taken through the recorded motion before it. Where
    that is not known (an episode's first rows, windows without `past`), it begins at the end where the teeth transmit
    the torque of the first step.
    """

    name = "backlash"
    kind = "actuator"
    quantities = (Quantity("width", "rad", 0.0, math.inf, neutral=0.0),)
    step_fields = (*DRIVE_FIELDS, "dof_armature", "opt.timestep")
    step_order = 1
    taken_fields = ("actuator_ctrlrange", "actuator_armature", "actuator_damping")
    threshold = True
    sentence = "The gear has play: after a change of the torque's direction the motor turns freely for a moment."
    confounders = ("dead_zone", "coulomb_friction", "stribeck_friction", "actuation_delay")

    resists: ClassVar[bool] = False
    """Whether the joint's damping and friction are the rotor's."""
    outer: ClassVar[bool] = False
    """Whether servos measure the joint, not the rotor."""

    drives: Drives
    spare: Array
    """Inertia (k,) of the rotors whose joints have no armature."""
    traits: Rows
    """Of each, in bits: 1 for `resists`, 2 for `outer` (k,)."""

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """See `play_bounds`; on motors and servos whose rotor is the joint's."""
        if element < 0 or not is_plain(model, element) or _of_its_own(model, element):
            return None
        return play_bounds(model, element, scales)

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: an actuator that is no motor or servo on a hinge or slide, or two on one joint, or one with an
                armature or damping that the model does not give to the joint.
        """
        bound = super().bind(model)
        bound.drives = Drives.of(model, bound.ids, f"{self.name} on {self.target!r}")
        for i, joint in zip(bound.ids.tolist(), bound.drives.joints.tolist(), strict=True):
            own = _of_its_own(model, i)
            if own:
                raise BadEffect(
                    f"{self.name} on {self.target!r}: the model gives actuator #{i} {' and '.join(own)}, and the rotor "
                    f"of this effect has what its joint is given; give joint #{joint} the same, times the square of "
                    f"the gear ({model.actuator_gear[i, 0]:g}), and the actuator none: the robot stays as it is"
                )
        if len(set(bound.drives.joints.tolist())) < len(bound.ids):
            raise BadEffect(f"{self.name} on {self.target!r}: two of these actuators drive one joint; target one")
        bound.spare = _ROTOR * model.dof_M0[bound.drives.dofs]
        bound.traits = np.full(len(bound.ids), self.resists + 2 * self.outer, dtype=np.intp)
        return bound

    def recall_time(self) -> float:
        """See `Effect.recall_time`."""
        return _RECALL

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Couple or uncouple the rotors for this step, and move those that are free to its end.

        The memory of each rotor: the end of the play it is at (+1 or -1, 0 in between), its position and speed as
        seen at the joint, and the joint's speed one step ago (NaN where the change since says nothing). A rotor's end
        is NaN until it is known.
        """
        d, half, dt = self.drives, 0.5 * values, world.fields["opt.timestep"][rows, None]  # as `time_scale` has it
        memory = world.memory.setdefault(self, np.full((4, len(world.qpos), len(self.ids)), np.nan))
        side, position, speed, before = memory[:, rows]
        joint, joint_speed = world.qpos[np.ix_(rows, d.qposadr)], world.qvel[np.ix_(rows, d.dofs)]
        armature = world.fields["dof_armature"][np.ix_(rows, d.dofs)]
        inertia = np.where(armature > 0, armature, self.spare)
        drag, friction = self._resistance(world, rows)
        acceleration = np.where(np.isnan(before), 0.0, joint_speed - before) / dt
        unknown = np.isnan(side)
        if unknown.any():  # in the first step, and in the second, which knows the acceleration
            lost = inertia * acceleration + _resisting(joint_speed, drag, friction, dt / inertia)
            pushing = np.where(d.torque(world, rows) - lost < 0, -1.0, 1.0)
            side = np.where(unknown, pushing, side)

        # free rotors that cross the play nearer to now than to the next step meet the joint, if not on their way back
        closing = speed - joint_speed
        ahead = position - joint + 0.5 * dt * closing
        met = (side == 0) & (np.abs(ahead) >= half) & (ahead * closing >= 0)
        world.qfrc_applied[np.ix_(rows, d.dofs)] += np.where(met, inertia * closing / dt, 0.0)
        side = np.where(met, np.sign(ahead), side)

        # rotors at an end stay there while the teeth push
        position = np.where(side != 0, joint + side * half, position)
        speed = np.where(side != 0, joint_speed, speed)
        torque = d.torque(world, rows) if self.outer else d.torque(world, rows, position, speed)
        lost = inertia * acceleration + _resisting(speed, drag, friction, dt / inertia)
        side = np.where(~met & (side * (torque - lost) < 0), 0.0, side)

        stiffness, damping = self._couple(world, rows, side == 0, position - joint)
        whole = inertia + dt * (damping + drag + dt * stiffness)
        # of use, as the position, while the rotor is free; friction stops, and turns nothing round
        speed = speed + dt * (torque - drag * speed - dt * stiffness * speed) / whole
        speed = speed - np.clip(speed, -dt * friction / whole, dt * friction / whole)
        side = np.where(unknown & np.isnan(before), np.nan, side)
        memory[:, rows] = side, position + dt * speed, speed, np.where(met, np.nan, joint_speed)

    def _resistance(self, world: World, rows: Rows) -> tuple[Array | float, Array | float]:
        """Damping and friction of the rotors, (n, k) each."""
        if not self.resists:
            return 0.0, 0.0
        cell = np.ix_(rows, self.drives.dofs)
        return world.fields["dof_damping"][cell], world.fields["dof_frictionloss"][cell]

    def _couple(self, world: World, rows: Rows, free: NDArray[np.bool_], ahead: Array) -> tuple[Array, Array]:
        """Cut free rotors off their joints, and let servos measure the rotors that are not; (n, k) each.

        Returns:
            Stiffness and damping of the servos at the joint.
        """
        d = self.drives
        gain, bias = world.fields["actuator_gainprm"], world.fields["actuator_biasprm"]
        gear = d.field(world, "actuator_gear", rows)[..., 0]
        own = d.field(world, "actuator_biasprm", rows) * (world.model.actuator_biastype[d.ids] == _AFFINE)[:, None]
        if not self.outer:
            bias[(*np.ix_(rows, d.ids), 0)] += own[..., 1] * gear * ahead
        cell = (rows[:, None], d.ids[None, :])
        bias[cell] *= ~free[..., None]
        gain[cell] *= ~free[..., None]
        for name in ("dof_armature", *(("dof_damping", "dof_frictionloss") if self.resists else ())):
            world.fields[name][np.ix_(rows, d.dofs)] *= ~free
        if self.outer:
            return np.zeros(gear.shape), np.zeros(gear.shape)
        stiffness, damping = (np.clip(-(gear**2) * own[..., i], 0.0, None) for i in (1, 2))
        return stiffness, damping


def play_bounds(model: mujoco.MjModel, actuator: int, scales: DataScales) -> Bounds:
    """Up to the spread of the joint's position, at most a third of a radian or a tenth of the robot."""
    joint = int(model.actuator_trnid[actuator, 0])
    hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
    spread = float(scales.position[model.jnt_dofadr[joint]])
    return {"width": (0.0, min(spread, 0.3 if hinge else 0.1 * scales.length))}


def _of_its_own(model: mujoco.MjModel, actuator: int) -> list[str]:
    """What an actuator has that would stay at the joint while its rotor is free."""
    damped = model.actuator_damping[actuator] != 0 or model.actuator_dampingpoly[actuator].any()
    held = (("an armature", model.actuator_armature[actuator] != 0), ("damping", damped))
    return [name for name, there in held if there]


def _resisting(speed: Array, drag: Array | float, friction: Array | float, per_torque: Array) -> Array:
    """Torque against a motion, (n, k); friction gives way to rest within the speed that it takes in a step."""
    stopped = np.where(friction > 0, friction * per_torque, 1.0)  # where there is none, what of it is no matter
    return drag * speed + friction * np.clip(speed / stopped, -1.0, 1.0)


@register
class BacklashGeared(Backlash):
    """`backlash` with the joint's damping and friction on the rotor's side of the play, as of a motor and its gear."""

    name = "backlash_geared"
    says = "backlash"
    step_fields = (*Backlash.step_fields, "dof_damping", "dof_frictionloss")
    step_order = 3  # what resists is complete then
    resists = True
    sentence = "The gear has play, and what resists is on the motor's side: in between the joint moves freely."


@register
class BacklashOuter(Backlash):
    """`backlash` of a servo whose encoder sits at the joint, beyond the play."""

    name = "backlash_outer"
    says = "backlash"
    outer = True
    sentence = "The gear has play, and the servo's encoder sits beyond it, at the joint."

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """As for `backlash`, on position and velocity servos."""
        servo = element >= 0 and (is_servo(model, element) or is_speed_servo(model, element))
        return super().bounds_for(model, element, scales) if servo else None


@register
class BacklashGearedOuter(BacklashOuter):
    """`backlash_outer` with the joint's damping and friction on the rotor's side of the play."""

    name = "backlash_geared_outer"
    step_fields = BacklashGeared.step_fields
    step_order = BacklashGeared.step_order
    resists = True
    sentence = "The gear has play, what resists is on the motor's side, and the servo's encoder is at the joint."
