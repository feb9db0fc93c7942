"""Actuators that follow their commands with a lag."""

import math
from typing import ClassVar, Self

import mujoco
import numpy as np

from nfpde.effects.drive import clamped
from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales

_SETTLED = 5.0
"""Time constants after which a command is as good as forgotten: 0.7 % of it is left."""


@register
class ActuatorLag(Effect):
    """A first-order lag between a command u and what the actuator acts on: time_constant dy/dt = u - y.

    Commands are constant in a physics step, so the filter is solved exactly; every step gets the mean of y over it,
    which tends to u for short time constants. y starts at the first command that is known. Commands are clamped to
    ctrlrange before, as MuJoCo clamps those of its own filters.
    """

    name = "actuator_lag"
    kind = "actuator"
    quantities = (Quantity("time_constant", "s", 0.0, math.inf, neutral=0.0),)
    taken_fields = ("actuator_ctrlrange",)
    default_bounds: ClassVar[Bounds] = {"time_constant": (0.0, 0.1)}
    sentence = "The actuator follows its command with a lag: motor inductance, a current or valve loop, a filter."
    confounders = ("actuation_delay", "observation_delay", "armature")

    model: mujoco.MjModel

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to 0.2 seconds (propellers, valves) or five control steps, on one actuator or all."""
        return {"time_constant": (0.0, max(0.2, 5 * scales.control_dt))}

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`."""
        bound = super().bind(model)
        bound.model = model
        return bound

    def memory_time(self) -> float:
        """Five of the longest time constants [s]."""
        return _SETTLED * self.parameters[0].high

    def command(self, ctrl: Array, values: Array, timestep: float) -> Array:
        """Filter the commands of the target's actuators."""
        steps = timestep / np.maximum(values[:, 0], 1e-300)
        kept = np.exp(-steps)[:, None]  # share of y that is left after a step
        mean = (-np.expm1(-steps) / steps)[:, None]  # of u - y, on average over a step
        out = ctrl.copy()
        every = clamped(self.model, self.ctrls, ctrl[:, :, self.ctrls])
        y = every[:, 0]
        for s in range(ctrl.shape[1]):
            u = every[:, s]
            out[:, s, self.ctrls] = u + (y - u) * mean
            y = u + (y - u) * kept
        return out
