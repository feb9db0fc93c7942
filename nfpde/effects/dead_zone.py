"""Actuators that do not answer to small commands."""

from __future__ import annotations

import math
from typing import Self

import mujoco
import numpy as np

from nfpde.effects.drive import Drives, is_plain, is_servo
from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows, World
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales


@register
class DeadZone(Effect):
    """Nothing within `half_width` of zero, and half_width less beyond it.

    A motor loses the middle of its command; a position servo that of its error, command minus position as its gains
    count it: behind its gear, and as the encoder says it where `joint_offset` or `sensor_scale` changed that. Commands
    are clamped to ctrlrange before.
    """

    name = "dead_zone"
    kind = "actuator"
    quantities = (Quantity("half_width", "ctrl unit", 0.0, math.inf, neutral=0.0),)
    step_fields = ("actuator_biasprm", "actuator_gainprm", "actuator_gear")
    step_order = -1
    taken_fields = ("actuator_ctrlrange",)
    threshold = True
    sentence = "The actuator does not answer until the command, or a servo's error, exceeds a threshold."
    confounders = ("coulomb_friction", "backlash", "stribeck_friction", "motor_strength")

    motors: Drives
    servos: Drives
    model: mujoco.MjModel

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to twice the typical command of a motor, or twice the typical error of a position servo."""
        if element < 0 or not is_plain(model, element):
            return None
        size = float(scales.ctrl[model.actuator_ctrladr[element]])
        if is_servo(model, element):
            size = float(scales.actuator_force[element] / abs(model.actuator_biasprm[element, 1]))
        return {"half_width": (0.0, 2 * size)} if size > 0 else None

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: an actuator that is no motor or servo on a hinge or slide.
        """
        bound = super().bind(model)
        of_servos = np.array([is_plain(model, int(i)) and is_servo(model, int(i)) for i in bound.ids])
        bound.motors = Drives.of(model, bound.ids[~of_servos], f"{self.name} on {self.target!r}")
        bound.servos = Drives.of(model, bound.ids[of_servos], f"{self.name} on {self.target!r}")
        bound.model = model
        return bound

    def command(self, ctrl: Array, values: Array, timestep: float) -> Array:
        """Take the middle out of the commands of motors."""
        if not len(self.motors.ids):
            return ctrl
        out = ctrl.copy()
        sent = self.motors.clamped(self.model, ctrl[:, :, self.motors.ctrls])
        out[:, :, self.motors.ctrls] = self._passed(sent, values[:, :1, None])
        return out

    def _passed(self, sent: Array, half: Array) -> Array:
        """What of commands is beyond the zone."""
        return sent - np.clip(sent, -half, half)

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Take the middle out of the errors of position servos: what the servo gives less goes into its bias."""
        servos = self.servos
        if not len(servos.ids):
            return
        gain, force = self._gain_and_force(world, rows)
        most = np.abs(gain) * values
        world.fields["actuator_biasprm"][(*np.ix_(rows, servos.ids), 0)] -= np.clip(force, -most, most)

    def _gain_and_force(self, world: World, rows: Rows) -> tuple[Array, Array]:
        """Gains of the position servos, and these times their errors, (n, k) each."""
        servos = self.servos
        gear, gain = (servos.field(world, f"actuator_{name}", rows)[..., 0] for name in ("gear", "gainprm"))
        own = servos.field(world, "actuator_biasprm", rows)
        sent = servos.clamped(world.model, world.ctrl[np.ix_(rows, servos.ctrls)])
        # from what the servo makes of its reading; no division, as other effects may leave no gain
        return gain, gain * sent + own[..., 0] + own[..., 1] * gear * world.qpos[np.ix_(rows, servos.qposadr)]


@register
class DeadZoneGate(DeadZone):
    """`dead_zone` as a gate: nothing within `half_width` of zero, and all beyond it.

    A motor or velocity servo ignores such commands; a position servo switches off while its error is that small, its
    damping too.
    """

    name = "dead_zone_gate"
    says = "dead_zone"
    step_order = -2  # of the whole error
    sentence = "The actuator does not answer until the command, or a servo's error, exceeds a threshold, then in full."

    def _passed(self, sent: Array, half: Array) -> Array:
        """Commands that are not small, as they are."""
        return np.where(np.abs(sent) <= half, 0.0, sent)

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Switch position servos off whose errors are small."""
        servos = self.servos
        if not len(servos.ids):
            return
        gain, force = self._gain_and_force(world, rows)
        beyond = np.abs(force) > np.abs(gain) * values
        cell = (rows[:, None], servos.ids[None, :])
        world.fields["actuator_gainprm"][cell] *= beyond[..., None]
        world.fields["actuator_biasprm"][cell] *= beyond[..., None]
