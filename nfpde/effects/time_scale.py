"""Clocks that run wrong."""

from typing import ClassVar

import mujoco

from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register


@register
class TimeScale(Effect):
    """A step of the recording lasts `ratio` times as long as assumed: MuJoCo's `opt.timestep`, scaled.

    Speeds are taken to be measured in true seconds, as a motor controller's are; times of other effects count in
    assumed seconds. What other effects move, as `backlash` its rotors, moves in true ones.
    """

    name = "time_scale"
    kind = None
    quantities = (Quantity("ratio", "-", 0.1, 10.0, neutral=1.0, log=True),)
    default_bounds: ClassVar[Bounds] = {"ratio": (0.8, 1.25)}
    sentence = "Control steps last longer or shorter than the recording says: a wrong rate, or a clock that drifts."
    confounders = ("sensor_scale", "motor_strength", "observation_delay")

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Scale the time step."""
        model.opt.timestep *= values[0]
