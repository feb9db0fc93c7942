"""Faults of the drive itself: strength, servo gains, limits of torque, play in the gear."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from nfpde.bench.gap.faults.base import Array, Fault, joint_of, kind_of

if TYPE_CHECKING:
    from nfpde.bench.gap.plant import Plant


class Strength(Fault):
    """Everything the motor exerts is scaled: a weak magnet, a low battery."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Scale the torque per command and, of a servo, its feedback."""
        i = model.actuator(self.target).id
        model.actuator_gainprm[i] *= self.values["scale"]
        model.actuator_biasprm[i] *= self.values["scale"]


class AimedShort(Strength):
    """The servo takes a share of its command for its aim: a setpoint in another unit."""

    reading = "command"

    @classmethod
    def differs(cls, model: mujoco.MjModel, target: str) -> bool:
        """Where there is feedback that stays."""
        return kind_of(model, model.actuator(target).id) != "torque"

    def alter(self, model: mujoco.MjModel) -> None:
        """Scale the torque per command."""
        model.actuator_gainprm[model.actuator(self.target).id, 0] *= self.values["scale"]


class ServoGain(Fault):
    """The servo's firmware runs with other gains than documented."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Of a position servo both gains, of a velocity servo its only one."""
        i = model.actuator(self.target).id
        if kind_of(model, i) == "position":
            model.actuator_gainprm[i, 0] *= self.values["kp_scale"]
            model.actuator_biasprm[i, 1] *= self.values["kp_scale"]
        else:
            model.actuator_gainprm[i, 0] *= self.values["kv_scale"]
        model.actuator_biasprm[i, 2] *= self.values["kv_scale"]


class TorqueLimit(Fault):
    """The current is limited: no more than `limit` at the joint, either way."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Limit the joint's actuation force, which is measured after the gear."""
        joint = joint_of(model, self.target)
        model.jnt_actfrclimited[joint] = 1
        model.jnt_actfrcrange[joint] = (-self.values["limit"], self.values["limit"])


class TorqueSpeed(Fault):
    """A supply of limited voltage: the torque at hand falls in a line from stall to the no-load speed."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Switch the joint's limit on; `push` sets it."""
        model.jnt_actfrclimited[joint_of(model, self.target)] = 1

    def push(self, plant: Plant) -> None:
        """The motor can drive less the faster it turns, and brake with its full torque."""
        joint = joint_of(plant.model, self.target)
        ratio = plant.data.qvel[plant.model.jnt_dofadr[joint]] / self.values["no_load_speed"]
        stall = self.values["stall_torque"]
        plant.model.jnt_actfrcrange[joint] = (
            -stall * np.clip(1 + ratio, 0, 1),
            stall * np.clip(1 - ratio, 0, 1),
        )


class GearPlay(Fault):
    """Play between motor and joint: a rotor of its own, which pushes the joint only where the play is used up.

    The rotor has the joint's armature for inertia, and a servo's feedback comes from the rotor; the recording shows
    the joint. `width` is the whole play.
    """

    ROTOR_STEPS = 8
    STIFFNESS = 0.2
    """Stiffness of the teeth, of what one physics step of the lighter side could still follow."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Take motor and rotor off the joint; a rest of the armature keeps light joints well posed."""
        i, joint = model.actuator(self.target).id, joint_of(model, self.target)
        dof = model.jnt_dofadr[joint]
        self._gain, self._bias = model.actuator_gainprm[i, 0], model.actuator_biasprm[i, :3].copy()
        self._gear, self._rotor = model.actuator_gear[i, 0], 0.9 * model.dof_armature[dof]
        model.actuator_gainprm[i] = 0
        model.actuator_biasprm[i] = 0
        model.dof_armature[dof] *= 0.1
        self._actuator, self._qpos, self._dof = i, model.jnt_qposadr[joint], dof
        self._drag = self._taken_along(model, int(dof))

    def _taken_along(self, model: mujoco.MjModel, dof: int) -> float:
        """Damping that goes with the rotor: none, the bearing is the joint's."""
        return 0.0

    def begin(self, plant: Plant, ctrl: Array) -> None:
        """The rotor stands in the middle of the play."""
        data = plant.data
        self.memory = {"angle": float(data.qpos[self._qpos]), "speed": float(data.qvel[self._dof])}
        unit = np.zeros((1, plant.model.nv))
        unit[0, self._dof] = 1
        answer = np.zeros_like(unit)
        mujoco.mj_solveM(plant.model, data, answer, unit)
        lighter = min(self._rotor, 1 / answer[0, self._dof])
        self.memory["stiffness"] = self.STIFFNESS * lighter / plant.model.opt.timestep**2

    def push(self, plant: Plant) -> None:
        """Move the rotor in small steps, the joint going on at its speed; push the joint by the mean tooth force."""
        data, memory = plant.data, self.memory
        dt = plant.model.opt.timestep / self.ROTOR_STEPS
        q, v = float(data.qpos[self._qpos]), float(data.qvel[self._dof])
        angle, speed, total = memory["angle"], memory["speed"], 0.0
        for _ in range(self.ROTOR_STEPS):
            drive = self._gain * data.ctrl[self._actuator] + self._bias[0]
            drive += self._gear * (self._bias[1] * angle + self._bias[2] * speed)
            tooth = self._tooth(angle - q, speed - v)
            speed += dt * (self._gear * drive - tooth - self._drag * speed) / self._rotor
            angle += dt * speed
            q += dt * v
            total += tooth
        memory["angle"], memory["speed"] = angle, speed
        data.qfrc_applied[self._dof] += total / self.ROTOR_STEPS

    def _tooth(self, apart: float, speed: float) -> float:
        inside = self.values["width"] / 2
        stiffness = self.memory["stiffness"]
        damping = 0.6 * np.sqrt(stiffness * self._rotor)
        if apart > inside:
            return max(stiffness * (apart - inside) + damping * speed, 0.0)
        if apart < -inside:
            return min(stiffness * (apart + inside) + damping * speed, 0.0)
        return 0.0

    def disturb(self, plant: Plant, dq: Array, dv: Array) -> None:
        """The rotor moves along, so that a measurement error does not bend the teeth."""
        self.memory["angle"] += float(dq[self._dof])
        self.memory["speed"] += float(dv[self._dof])


class DraggedGearPlay(GearPlay):
    """The same with the joint's damping in the gearbox, on the motor's side of the play."""

    reading = "damping in the gearbox"

    @classmethod
    def differs(cls, model: mujoco.MjModel, target: str) -> bool:
        """Where there is damping."""
        return bool(model.dof_damping[model.jnt_dofadr[joint_of(model, target)]] > 0)

    def _taken_along(self, model: mujoco.MjModel, dof: int) -> float:
        drag = float(model.dof_damping[dof])
        model.dof_damping[dof] = 0
        return drag
