"""Measurements that arrive late."""

from __future__ import annotations

from typing import Self

import mujoco
import numpy as np

from nfpde.effects.actuation_delay import ActuationDelay
from nfpde.effects.effect import Bounds, Rows
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales


@register
class ObservationDelay(ActuationDelay):
    """All measurements are `delay` old when they are recorded: the row of time t holds the state of t - delay.

    A replay starts from a measured state, which is the true one of `delay` earlier, and is compared with measured
    ones. The motion in between is that under the commands sent `delay` before each row: in an open-loop replay the
    effect is the same as `actuation_delay` on all actuators, and no recording of commands and states tells the two
    apart.
    """

    name = "observation_delay"
    kind = None
    sentence = "Measurements are old when they are recorded: sensors, filters and communication take time."
    confounders = ("actuation_delay", "actuator_lag")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """As for the actuation delay; None without commands."""
        return super().bounds_for(model, element, scales) if model.nu else None

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`; `ctrls` are all commands."""
        bound = super().bind(model)
        bound.ctrls = np.arange(model.nu)
        return bound

    def actuators(self) -> Rows:
        """See `Effect.actuators`; all of them."""
        return np.arange(self.model.nactuator)
