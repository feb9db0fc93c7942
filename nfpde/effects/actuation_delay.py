"""Commands that reach the actuators late."""

from typing import ClassVar, Self

import mujoco
import numpy as np

from nfpde.effects.drive import clamped
from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales


@register
class ActuationDelay(Effect):
    """A pure delay between a command and the actuator that receives it.

    The command is held constant between physics steps, so a delay that is no multiple of the time step gives each
    step the average of the two commands it overlaps: exact on average, and continuous in the delay. Commands are
    clamped to ctrlrange before.
    """

    name = "actuation_delay"
    kind = "actuator"
    quantities = (Quantity("delay", "s", 0.0, 1.0, neutral=0.0),)
    taken_fields = ("actuator_ctrlrange",)
    default_bounds: ClassVar[dict[str, tuple[float, float]]] = {"delay": (0.0, 0.1)}
    sentence = "Commands act late: communication and drive electronics hold them back."
    confounders = ("observation_delay", "actuator_lag")

    model: mujoco.MjModel

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to 0.3 seconds (hobby servos on a bus take 0.1) or five control steps, on one actuator or all."""
        return {"delay": (0.0, min(1.0, max(0.3, 5 * scales.control_dt)))}

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`."""
        bound = super().bind(model)
        bound.model = model
        return bound

    def memory_time(self) -> float:
        """The longest delay [s]."""
        return self.parameters[0].high

    def command(self, ctrl: Array, values: Array, timestep: float) -> Array:
        """Shift the commands of the target's actuators by the delay; the first one holds before the start."""
        steps = ctrl.shape[1]
        late = values[:, 0] / timestep
        whole = np.floor(late + 1e-9)
        share = (late - whole)[:, None, None]
        share[share < 1e-9] = 0.0  # a whole number of steps but for rounding: a plain shift
        index = np.arange(steps)[None, :] - whole[:, None].astype(int)
        rows = np.arange(len(ctrl))[:, None]
        chosen = clamped(self.model, self.ctrls, ctrl[:, :, self.ctrls])
        newer = chosen[rows, np.clip(index, 0, None)]
        older = chosen[rows, np.clip(index - 1, 0, None)]
        out = ctrl.copy()
        out[:, :, self.ctrls] = (1 - share) * newer + share * older
        return out
