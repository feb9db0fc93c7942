"""Clocks that run wrong."""

from typing import ClassVar, Self

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Bounds, Effect, Quantity, Rows
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


@register
class TimeScaleCounted(TimeScale):
    """`time_scale` where speeds count in assumed seconds, too, as differences of positions over a wrong step do."""

    name = "time_scale_counted"
    says = "time_scale"
    sentence = "Control steps last longer or shorter than the recording says, and its speeds were taken over that step."

    speeds: Rows
    """Where speeds stand in a state (nv,)."""

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`."""
        bound = super().bind(model)
        bound.speeds = model.nq + np.arange(model.nv)
        return bound

    def to_simulated(self, state: Array, values: Array) -> Array:
        """Speeds in true seconds."""
        out = np.array(state)
        out[..., self.speeds] /= values
        return out

    def to_measured(self, state: Array, values: Array) -> Array:
        """Speeds in assumed seconds."""
        out = np.array(state)
        out[..., self.speeds] *= values
        return out
