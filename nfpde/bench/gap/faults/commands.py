"""Faults between the command and the drive: dead time, lag, bias, dead zone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nfpde.bench.gap.faults.base import Array, Fault

if TYPE_CHECKING:
    from nfpde.bench.gap.plant import Plant


def _channels(plant: Plant, target: str) -> slice | int:
    return slice(None) if target == "all" else int(plant.model.actuator(target).id)


class DeadTime(Fault):
    """The drive gets each command `delay` seconds late (a bus, a slow firmware)."""

    def begin(self, plant: Plant, ctrl: Array) -> None:
        """Fill the line with the command that held before."""
        steps = round(self.values["delay"] / plant.model.opt.timestep)
        self.memory = {"line": [ctrl.copy() for _ in range(steps)]}

    def command(self, plant: Plant, ctrl: Array) -> Array:
        """Put the new command in, take the oldest out."""
        line = self.memory["line"]
        line.append(ctrl.copy())
        late, which = line.pop(0), _channels(plant, self.target)
        out = ctrl.copy()
        out[which] = late[which]
        return out

    def remember(self) -> dict[str, list[Array]]:
        """The line; its arrays are never written to, so they are shared."""
        return {"line": list(self.memory["line"])}

    def recall(self, memory: dict[str, list[Array]]) -> None:
        """Take a line up again."""
        self.memory = {"line": list(memory["line"])}


TICKS = 16
"""Turns of a drive's own loop in a physics step."""


class Lag(Fault):
    """The drive's set point follows the command like a low pass of first order.

    Its loop is faster than the physics, which feels the mean: a set point taken at the end of a physics step would
    belong to a time constant that is half a step shorter.
    """

    def begin(self, plant: Plant, ctrl: Array) -> None:
        """Settled at the command that held before."""
        self.memory = {"held": ctrl.copy()}

    def command(self, plant: Plant, ctrl: Array) -> Array:
        """The mean over the physics step, by trapezoids, of a set point that follows a constant command."""
        kept = np.exp(-plant.model.opt.timestep / TICKS / self.values["time_constant"])
        held, area = self.memory["held"], np.zeros_like(ctrl)
        for _ in range(TICKS):
            before, held = held, ctrl + (held - ctrl) * kept
            area += 0.5 * (before + held)
        self.memory = {"held": held}
        which = _channels(plant, self.target)
        out = ctrl.copy()
        out[which] = area[which] / TICKS
        return out


class Bias(Fault):
    """The drive's zero is off: it acts as if `offset` were added to each command."""

    def command(self, plant: Plant, ctrl: Array) -> Array:
        """Add the offset."""
        out = ctrl.copy()
        out[_channels(plant, self.target)] += self.values["offset"]
        return out


class DeadZone(Fault):
    """Small commands do nothing, larger ones lose `half_width` of their size."""

    def command(self, plant: Plant, ctrl: Array) -> Array:
        """Shrink towards zero."""
        out, which = ctrl.copy(), _channels(plant, self.target)
        out[which] = np.sign(out[which]) * np.maximum(np.abs(out[which]) - self.values["half_width"], 0)
        return out


class Gate(DeadZone):
    """Small commands do nothing, larger ones pass as they are."""

    reading = "gate"

    def command(self, plant: Plant, ctrl: Array) -> Array:
        """Hold small ones back."""
        out, which = ctrl.copy(), _channels(plant, self.target)
        passes = np.abs(out[which]) > self.values["half_width"]
        out[which] = np.where(passes, out[which], 0.0)
        return out
