"""Sensors that are wrong in the log alone: the servo's own is right."""

from typing import Self

import mujoco
import numpy as np

from nfpde.effects.drive import servos_on, unread_on
from nfpde.effects.effect import Array, Bounds, Effect
from nfpde.effects.joint_offset import JointOffset
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.effects.sensor_scale import SensorScale


class Logged(Effect):
    """An effect on what is recorded of a joint, without its part in what a servo reads."""

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """As for the effect, on joints whose sensor something reads: elsewhere it is the same."""
        joint = np.array([element])
        differs = element >= 0 and (len(servos_on(model, joint)) > 0 or unread_on(model, joint))
        return super().bounds_for(model, element, scales) if differs else None

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Nothing in the robot is off."""


@register
class JointOffsetLogged(Logged, JointOffset):
    """`joint_offset` as what a log does alone: the recorded position is off, the servo acts on the true one."""

    name = "joint_offset_logged"
    says = "joint_offset"
    sentence = "The zero of the recorded position is off by a constant; the servo itself reads right."


@register
class SensorScaleLogged(Logged, SensorScale):
    """`sensor_scale` as what a log does alone: the recorded motion is scaled, the servo acts on the true one."""

    name = "sensor_scale_logged"
    says = "sensor_scale"
    sentence = "The recorded motion is a fixed multiple of the true one; the servo itself reads right."


@register
class SensorScalePosition(SensorScale):
    """`sensor_scale` of the recorded position alone: speeds are right, and so is what a servo reads."""

    name = "sensor_scale_position"
    says = "sensor_scale"
    sentence = "The recorded position is a fixed multiple of the true one; speeds, and what a servo reads, are right."

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `SensorScale.bind`."""
        bound = super().bind(model)
        bound.read = bound.qposadr
        return bound

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Nothing in the robot is off."""
