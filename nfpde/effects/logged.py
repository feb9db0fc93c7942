"""Sensors that are wrong in the log alone: the servo's own is right."""

import mujoco
import numpy as np

from nfpde.effects.drive import servos_on
from nfpde.effects.effect import Array, Bounds
from nfpde.effects.joint_offset import JointOffset
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.effects.sensor_scale import SensorScale


def _has_servo(model: mujoco.MjModel, joint: int) -> bool:
    """Whether it makes a difference what a joint's servo reads."""
    return joint >= 0 and len(servos_on(model, np.array([joint]))) > 0


@register
class JointOffsetLogged(JointOffset):
    """`joint_offset` as what a log does alone: the recorded position is off, the servo acts on the true one."""

    name = "joint_offset_logged"
    says = "joint_offset"
    sentence = "The zero of the recorded position is off by a constant; the servo itself reads right."

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """As for `joint_offset`, on joints with a servo."""
        return super().bounds_for(model, element, scales) if _has_servo(model, element) else None

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Nothing in the robot is off."""


@register
class SensorScaleLogged(SensorScale):
    """`sensor_scale` as what a log does alone: the recorded motion is scaled, the servo acts on the true one."""

    name = "sensor_scale_logged"
    says = "sensor_scale"
    sentence = "The recorded motion is a fixed multiple of the true one; the servo itself reads right."

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """As for `sensor_scale`, on joints with a servo."""
        return super().bounds_for(model, element, scales) if _has_servo(model, element) else None

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Nothing in the robot is off."""


@register
class SensorScalePosition(SensorScale):
    """`sensor_scale` of the recorded position alone: speeds are right, and so is what a servo reads."""

    name = "sensor_scale_position"
    says = "sensor_scale"
    sentence = "The recorded position is a fixed multiple of the true one; speeds, and what a servo reads, are right."

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Nothing in the robot is off."""

    def to_simulated(self, state: Array, values: Array) -> Array:
        """Divide positions by the scale."""
        out = np.array(state)
        out[..., self.qposadr] /= values
        return out

    def to_measured(self, state: Array, values: Array) -> Array:
        """Multiply positions by the scale."""
        out = np.array(state)
        out[..., self.qposadr] *= values
        return out
