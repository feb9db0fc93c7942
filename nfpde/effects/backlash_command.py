"""Play in what a servo is told."""

from __future__ import annotations

from typing import Self

import mujoco
import numpy as np

from nfpde.effects.backlash import Backlash, play_bounds
from nfpde.effects.drive import Drives, is_servo
from nfpde.effects.effect import Array, Bounds, Effect
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales
from nfpde.errors import BadEffect

_REMEMBERED = 1.0
"""Time [s] of commands in which most turn round, and so say where in the play they are."""


@register
class BacklashCommand(Effect):
    """`backlash` as hysteresis of a position servo's command: its aim follows when the command has crossed `width`.

    The play operator of Krasnosel'skii and Pokrovskii, Systems with Hysteresis, 1989: the aim stays within half the
    width of the command, and moves no more than that takes. `width` is that of the joint: of the command it is as many
    times as the nominal servo counts a radian or metre there. Commands are clamped to ctrlrange before.

    Play forgets nothing, commands are known for a second or more: the aim begins at the first of them, which is wrong
    where they had turned round just before and rest since. In an environment it would drift so; it is refused there.
    """

    name = "backlash_command"
    says = "backlash"
    kind = "actuator"
    quantities = Backlash.quantities
    taken_fields = ("actuator_ctrlrange",)
    threshold = True
    sentence = "The servo's aim lags behind its command by half a play, to either side."
    confounders = Backlash.confounders

    live = False
    forgets = False

    drives: Drives
    gears: Array
    """Commands for a radian or metre at the joint (k,)."""
    model: mujoco.MjModel

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """As for `backlash`, on position servos."""
        return play_bounds(model, element, scales) if element >= 0 and is_servo(model, element) else None

    def bind(self, model: mujoco.MjModel) -> Self:
        """See `Effect.bind`.

        Raises:
            BadEffect: an actuator that is no position servo on a hinge or slide.
        """
        bound = super().bind(model)
        wrong = [int(i) for i in bound.ids if not is_servo(model, int(i))]
        if wrong:
            raise BadEffect(f"{self.name} on {self.target!r}: actuator #{wrong[0]} is no position servo; target one")
        bound.drives = Drives.of(model, bound.ids, f"{self.name} on {self.target!r}")
        gain, feedback = model.actuator_gainprm[bound.ids, 0], model.actuator_biasprm[bound.ids, 1]
        bound.gears = np.abs(model.actuator_gear[bound.ids, 0] * feedback / np.where(gain == 0, np.inf, gain))
        bound.model = model
        return bound

    def memory_time(self) -> float:
        """As long as it takes most commands to turn round [s]."""
        return _REMEMBERED

    def command(self, ctrl: Array, values: Array, timestep: float) -> Array:
        """Let the aims follow."""
        half = 0.5 * values * self.gears
        out = ctrl.copy()
        every = self.drives.clamped(self.model, ctrl[:, :, self.ctrls])
        aim = every[:, 0]
        for s in range(ctrl.shape[1]):
            aim = np.clip(aim, every[:, s] - half, every[:, s] + half)
            out[:, s, self.ctrls] = aim
        return out
