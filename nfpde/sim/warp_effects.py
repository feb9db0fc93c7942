"""Effects on a Warp device: one kernel for each, found by the effect's name.

Effects that only write fields of the model need none: `ModelWriter` writes them into the staged rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.effects.effect import overrides
from nfpde.errors import BadEffect
from nfpde.kernels import commands, forces, friction, sensors
from nfpde.sim.acting import effect_columns

Array = NDArray[np.float64]


@dataclass
class Staged:
    """Parameters of effects on the device; see `nfpde.kernels` for their shapes."""

    values: wp.array
    active: wp.array
    world_row: wp.array

    def arrays(self) -> list[wp.array]:
        """As kernels take them."""
        return [self.values, self.active, self.world_row]


@dataclass(frozen=True)
class StepKernel:
    """The kernel of an effect before every physics step.

    Its arguments are, in order: what it reads, the staged values, `active` and `world_row`, the ids of the elements
    it acts on, the first column of its values, its column of `active`, and what it changes.

    kernel: launched for every world and element
    ids: attributes of a bound effect with the elements it acts on, all of one length
    reads: arrays of mjw.Data
    changes: arrays of mjw.Data, or model fields among the effect's `step_fields`, as (nworld, numbers) of floats
    """

    kernel: Any
    ids: tuple[str, ...]
    reads: tuple[str, ...]
    changes: tuple[str, ...]


COMMANDS: dict[str, Any] = {
    "actuation_delay": commands._delay_commands,
    "actuator_bias": commands._offset_commands,
    "actuator_lag": commands._lag_commands,
    "observation_delay": commands._delay_commands,
}
"""Effects on commands; all kernels have the same arguments, see `nfpde.kernels.commands`."""

STEPS: dict[str, StepKernel] = {
    "external_force": StepKernel(forces._push_bodies, ("ids",), (), ("xfrc_applied",)),
    "joint_spring": StepKernel(forces._pull_joints, ("dofs", "qposadr"), ("qpos",), ("qfrc_applied",)),
    "stribeck_friction": StepKernel(friction._add_stribeck_friction, ("dofs",), ("qvel",), ("dof_frictionloss",)),
}
"""Effects before every physics step."""

SENSORS: dict[str, Any] = {"joint_offset": sensors._offset_positions, "sensor_scale": sensors._scale_motion}
"""Effects on what is measured of joints; all kernels have the same arguments, see `nfpde.kernels.sensors`."""


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
        self.on_sensor = [i for i, e in enumerate(effects) if e.name in SENSORS]
        self.step_fields = sorted({f for i in self.on_step for f in effects[i].step_fields})

    def stage(self, xi: Array) -> tuple[Array, NDArray[np.int32]]:
        """Parameters of all effects (M, nvalue), and which effects act in each row (M, neffect)."""
        active = np.zeros((len(xi), max(1, len(self.effects))), np.int32)
        for i, (e, c) in enumerate(zip(self.effects, self.columns, strict=True)):
            active[:, i] = e.active(xi[:, c])
        return np.ascontiguousarray(xi[:, self.nbase :]), active

    def elements(self) -> list[list[wp.array]]:
        """Of every effect the ids of the elements its kernels act on, on Warp's current device."""
        return [
            [wp.array(np.asarray(getattr(e, n), np.int32), dtype=int) for n in _element_names(e)] for e in self.effects
        ]

    def change_commands(self, elements: list[list[wp.array]], staged: Staged, signal: wp.array) -> None:
        """Let the effects change the commands of all physics steps, (nworld, S, nu)."""
        for i in self.on_command:
            (ctrls,) = elements[i]
            wp.launch(
                COMMANDS[self.effects[i].name],
                dim=(signal.shape[0], ctrls.size),
                inputs=[*staged.arrays(), ctrls, self._first(i), i, self.timestep],
                outputs=[signal],
            )

    def before_step(
        self, elements: list[list[wp.array]], staged: Staged, d: mjw.Data, fields: dict[str, wp.array]
    ) -> None:
        """Let the effects act before a physics step, after fields and forces were put back."""
        for i in self.on_step:
            step = STEPS[self.effects[i].name]
            reads = [getattr(d, name) for name in step.reads]
            wp.launch(
                step.kernel,
                dim=(d.nworld, elements[i][0].size),
                inputs=[*reads, *staged.arrays(), *elements[i], self._first(i), i],
                outputs=[fields[name] if name in fields else getattr(d, name) for name in step.changes],
            )

    def measure(
        self,
        elements: list[list[wp.array]],
        staged: Staged,
        step: wp.array,
        nq: int,
        states: wp.array,
        *,
        back: bool = False,
    ) -> None:
        """Turn simulated states into measured ones, or back; `states` (nworld, H, nx), of which one step is changed."""
        for i in self.on_sensor if back else reversed(self.on_sensor):
            wp.launch(
                SENSORS[self.effects[i].name],
                dim=(states.shape[0], elements[i][0].size),
                inputs=[*staged.arrays(), *elements[i], self._first(i), step, nq, -1 if back else 1],
                outputs=[states],
            )

    def _first(self, effect: int) -> int:
        """Its first column of the staged values."""
        return self.columns[effect].start - self.nbase


def _element_names(effect: Effect) -> tuple[str, ...]:
    """The attributes of a bound effect that hold the elements its kernel acts on."""
    if effect.name in STEPS:
        return STEPS[effect.name].ids
    if effect.name in COMMANDS:
        return ("ctrls",)
    return ("qposadr", "dofs") if effect.name in SENSORS else ()


def _refuse_without_kernel(effect: Effect) -> None:
    missing = [
        *(["command"] if overrides(effect, "command") and effect.name not in COMMANDS else []),
        *(["step"] if overrides(effect, "step") and effect.name not in STEPS else []),
        *(m for m in ("to_simulated", "to_measured") if overrides(effect, m) and effect.name not in SENSORS),
    ]
    if missing:
        able = ", ".join(sorted([*COMMANDS, *STEPS, *SENSORS]))
        raise BadEffect(
            f"{effect.name} has no kernel for MuJoCo Warp ({', '.join(missing)}); use device='cpu'. Effects that "
            f"have one: {able}, and all that only change fields of the model"
        )
