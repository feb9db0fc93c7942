"""Effects on a Warp device: one kernel for each, found by the effect's name.

Effects that only write fields of the model need none: `ModelWriter` writes them into the staged rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.effects.effect import overrides
from nfpde.errors import BadEffect
from nfpde.kernels import commands, friction
from nfpde.sim.acting import effect_columns

Array = NDArray[np.float64]


@dataclass
class Staged:
    """Parameters of effects on the device; see `nfpde.kernels` for their shapes."""

    values: wp.array
    active: wp.array
    world_row: wp.array


@dataclass
class Step:
    """What a step effect may read and change before a physics step."""

    m: mjw.Model
    d: mjw.Data
    fields: dict[str, wp.array]
    """The fields of `step_fields`, as (nworld, numbers)."""
    staged: Staged


@dataclass
class Place:
    """Where an effect's parameters stand, and which elements it acts on, on the device."""

    effect: int
    """Its column of `active`."""
    first: int
    """Its first column of `values`."""
    dofs: wp.array
    ctrls: wp.array


def _stribeck(place: Place, step: Step) -> None:
    s = step.staged
    wp.launch(
        friction._add_stribeck_friction,
        dim=(step.d.nworld, place.dofs.size),
        inputs=[step.d.qvel, s.values, s.active, s.world_row, place.dofs, place.first, place.effect],
        outputs=[step.fields["dof_frictionloss"]],
    )


COMMANDS: dict[str, Any] = {"actuation_delay": commands._delay_commands}
"""Effects on commands; all kernels have the same arguments, see `nfpde.kernels.commands`."""

STEPS: dict[str, Callable[[Place, Step], None]] = {"stribeck_friction": _stribeck}
"""Effects before every physics step: what launches their kernel."""


class WarpEffects:
    """The effects of a simulator on a Warp device.

    Args:
        effects: bound effects.
        nbase: column of a parameter vector where their parameters begin.
        timestep: of the physics [s].

    Raises:
        BadEffect: an effect without a kernel.
    """

    def __init__(self, effects: Sequence[Effect], nbase: int, timestep: float) -> None:
        for e in effects:
            _refuse_without_kernel(e)
        self.effects = tuple(effects)
        self.timestep = timestep
        self.columns = effect_columns(effects, nbase)
        self.nbase = nbase
        self.nvalue = sum(len(e.parameters) for e in effects)
        self.on_command = [i for i, e in enumerate(effects) if overrides(e, "command")]
        self.on_step = [i for i, e in enumerate(effects) if overrides(e, "step")]
        self.step_fields = sorted({f for i in self.on_step for f in effects[i].step_fields})

    def stage(self, xi: Array) -> tuple[Array, NDArray[np.int32]]:
        """Parameters of all effects (M, nvalue), and which effects act in each row (M, neffect)."""
        active = np.zeros((len(xi), max(1, len(self.effects))), np.int32)
        for i, (e, c) in enumerate(zip(self.effects, self.columns, strict=True)):
            active[:, i] = e.active(xi[:, c])
        return np.ascontiguousarray(xi[:, self.nbase :]), active

    def places(self) -> list[Place]:
        """Each effect's place, on Warp's current device."""
        return [
            Place(i, c.start - self.nbase, _ids(e, "dofs"), _ids(e, "ctrls"))
            for i, (e, c) in enumerate(zip(self.effects, self.columns, strict=True))
        ]

    def change_commands(self, places: list[Place], staged: Staged, signal: wp.array) -> None:
        """Let the effects change the commands of all physics steps, (nworld, S, nu)."""
        for i in self.on_command:
            place = places[i]
            inputs = [staged.values, staged.active, staged.world_row, place.ctrls, place.first, i, self.timestep]
            kernel = COMMANDS[self.effects[i].name]
            wp.launch(kernel, dim=(signal.shape[0], place.ctrls.size), inputs=inputs, outputs=[signal])

    def before_step(self, places: list[Place], step: Step) -> None:
        """Let the effects act before a physics step, after fields and forces were put back."""
        for i in self.on_step:
            STEPS[self.effects[i].name](places[i], step)


def _ids(effect: Effect, name: str) -> wp.array:
    return wp.array(np.asarray(getattr(effect, name, ()), np.int32), dtype=int)


def _refuse_without_kernel(effect: Effect) -> None:
    missing = [
        *(["command"] if overrides(effect, "command") and effect.name not in COMMANDS else []),
        *(["step"] if overrides(effect, "step") and effect.name not in STEPS else []),
        *(m for m in ("to_simulated", "to_measured") if overrides(effect, m)),
    ]
    if missing:
        able = ", ".join(sorted([*COMMANDS, *STEPS]))
        raise BadEffect(
            f"{effect.name} has no kernel for MuJoCo Warp ({', '.join(missing)}); use device='cpu'. Effects that "
            f"have one: {able}, and all that only change fields of the model"
        )
