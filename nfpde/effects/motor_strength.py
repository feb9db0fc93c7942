"""Actuators that give more or less than they are asked for."""

from __future__ import annotations

from typing import ClassVar, Self, TypeVar

import mujoco
import numpy as np

from nfpde.effects.drive import is_servo, is_speed_servo
from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.errors import BadEffect

_GAIN, _BIAS = mujoco.mjtGain, mujoco.mjtBias
_PID, _MUSCLE_GAIN, _MUSCLE_BIAS = int(_GAIN.mjGAIN_PID), int(_GAIN.mjGAIN_MUSCLE), int(_BIAS.mjBIAS_MUSCLE)

_GAINS = (int(_GAIN.mjGAIN_FIXED), int(_GAIN.mjGAIN_AFFINE), int(_GAIN.mjGAIN_SO3), _PID, _MUSCLE_GAIN)
_BIASES = (int(_BIAS.mjBIAS_NONE), int(_BIAS.mjBIAS_AFFINE), int(_BIAS.mjBIAS_SO3), _MUSCLE_BIAS)
"""Gains and biases that are proportional to their parameters; of a muscle, to those of `_PEAK`."""

Bound = TypeVar("Bound", bound=Effect)

_PEAK = slice(2, 4)
"""A muscle's `force` and `scale`: its peak force is the one, or follows from the other where that is negative."""


@register
class MotorStrength(Effect):
    """All that an actuator does, times a factor: MuJoCo's `actuator_gainprm` and `actuator_biasprm`, scaled.

    For a servo both its gain and its damping change, as with a motor of another torque constant behind the same
    controller; for a muscle its peak force. Limits of the force stay as they are. The force of a `dcmotor`, of a plugin
    or of a function of yours is no multiple of these fields, nor is a torque that is fed forward.
    """

    name = "motor_strength"
    kind = "actuator"
    quantities = (Quantity("scale", "-", 0.0, 10.0, neutral=1.0),)
    default_bounds: ClassVar[Bounds] = {"scale": (0.3, 1.7)}
    sentence = "The motor gives a fixed share of the torque that the model expects: torque constant, voltage, wear."
    confounders = ("armature", "payload", "servo_gain", "viscous_damping")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """From a third to nearly twice the strength, on one actuator whose fields say its force."""
        return dict(cls.default_bounds) if element >= 0 and _is_scalable(model, element) else None

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: an actuator whose force is no multiple of its `gainprm` and `biasprm`.
        """
        bound = super().bind(model)
        for i in bound.ids:
            if not _is_scalable(model, int(i)):
                raise BadEffect(
                    f"{self.name} on {self.target!r}: the force of actuator #{i} is no multiple of its gainprm and "
                    "biasprm (it is a dcmotor, a plugin, of type user, or takes a torque that is fed forward); name "
                    "other actuators, or limit its torque with torque_limit or torque_speed"
                )
        return bound

    def screened(self, scales: DataScales) -> Array:
        """Weaker by a little and by much."""
        return np.array([[0.95], [0.7]])

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Scale gain and bias."""
        for prm, muscle in (
            (model.actuator_gainprm, model.actuator_gaintype[self.ids] == _MUSCLE_GAIN),
            (model.actuator_biasprm, model.actuator_biastype[self.ids] == _MUSCLE_BIAS),
        ):
            prm[self.ids[~muscle]] *= values[0]
            prm[self.ids[muscle], _PEAK] *= values[0]


@register
class MotorStrengthCommand(MotorStrength):
    """`motor_strength` of a servo as a factor on its command alone: its gain is scaled, its feedback is not."""

    name = "motor_strength_command"
    says = "motor_strength"
    sentence = "The servo aims at a fixed share of its command: a wrong unit or calibration of the setpoint."

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """As for `motor_strength`, on position and velocity servos."""
        return super().bounds_for(model, element, scales) if _feeds_back(model, element) else None

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: an actuator that is no position or velocity servo.
        """
        return _servos_only(super().bind(model), model)

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Scale the gain."""
        model.actuator_gainprm[self.ids] *= values[0]


@register
class MotorStrengthGear(MotorStrengthCommand):
    """`motor_strength` of a servo as another gear: MuJoCo's `actuator_gear`, through which it also sees its joint."""

    name = "motor_strength_gear"
    sentence = "The transmission gives a fixed share of the torque, and of the motion that the servo sees."

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Scale the gear."""
        model.actuator_gear[self.ids] *= values[0]


def _servos_only(bound: Bound, model: mujoco.MjModel) -> Bound:
    """The bound effect, where all its actuators are servos."""
    wrong = [int(i) for i in bound.ids if not _feeds_back(model, int(i))]
    if wrong:
        raise BadEffect(
            f"{bound.name} on {bound.target!r}: actuator #{wrong[0]} is no position or velocity servo; take "
            "motor_strength"
        )
    return bound


def _feeds_back(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether it makes a difference what of an actuator is scaled."""
    return actuator >= 0 and (is_servo(model, actuator) or is_speed_servo(model, actuator))


def _is_scalable(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator's force is a multiple of its gain's and its bias's parameters."""
    gain, bias = int(model.actuator_gaintype[actuator]), int(model.actuator_biastype[actuator])
    feeds_forward = gain == _PID and int(model.actuator_ctrlspec[actuator]) & int(mujoco.mjtCtrlInput.mjINPUT_FF)
    return gain in _GAINS and bias in _BIASES and int(model.actuator_plugin[actuator]) < 0 and not feeds_forward
