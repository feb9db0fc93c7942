"""Effects on a Warp device: one kernel for each, found by the effect's name.

Effects that only write fields of the model need none: `ModelWriter` writes them into the staged rows.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.effects.drive import switched_off
from nfpde.effects.effect import overrides
from nfpde.errors import BadEffect
from nfpde.kernels import backlash, commands, drives, forces, friction, gates, sensors
from nfpde.sim.acting import effect_columns, in_step_order

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
class Launch:
    """The kernel of an effect in one of its places, launched for every world and element.

    kernel: see `nfpde.kernels`
    elements: what it gets of each element; see `numbers_of`
    reads: what a kernel before a physics step reads: fields of the model, as (rows, numbers) of floats, then arrays of
        mjw.Data
    changes: what it changes: fields of the model, as (nworld, numbers) of floats, or arrays of mjw.Data
    memory: numbers it keeps of each element from step to step, as its first output (nworld, elements, numbers); NaN at
        the start of a window
    """

    kernel: Any
    elements: tuple[str, ...]
    reads: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    memory: int = 0


_CLAMPED = ("ctrls", "low", "high")

COMMANDS = {
    "actuation_delay": Launch(commands._delay_commands, _CLAMPED),
    "actuator_bias": Launch(commands._offset_commands, ("ctrls",)),
    "actuator_lag": Launch(commands._lag_commands, _CLAMPED),
    "backlash_command": Launch(commands._play_commands, ("drives.ctrls", "drives.low", "drives.high", "gears")),
    "dead_zone": Launch(drives._cut_commands, ("motors.ctrls", "motors.low", "motors.high")),
    "dead_zone_gate": Launch(gates._gate_commands, ("motors.ctrls", "motors.low", "motors.high")),
    "observation_delay": Launch(commands._delay_commands, _CLAMPED),
}
"""Effects on commands; all kernels have the same other arguments, see `nfpde.kernels.commands`."""

_TORQUE = ("actuator_gear", "actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "jnt_actfrcrange")
_DRIVES = tuple(f"drives.{name}" for name in ("ids", "joints", "qposadr", "dofs", "ctrls", "kind", "low", "high"))

_SERVOS = tuple(f"servos.{name}" for name in ("ids", "qposadr", "ctrls", "low", "high"))

_PLAY = Launch(
    backlash._play_rotors,
    (*_DRIVES, "spare", "traits"),
    ("opt.timestep", "actuator_gear", "actuator_forcerange", "jnt_actfrcrange", "ctrl", "qpos", "qvel"),
    ("actuator_gainprm", "actuator_biasprm", "dof_armature", "dof_damping", "dof_frictionloss", "qfrc_applied"),
    memory=4,
)

STEPS = {
    "backlash": _PLAY,
    "backlash_geared": _PLAY,
    "backlash_geared_outer": _PLAY,
    "backlash_outer": _PLAY,
    "dead_zone": Launch(
        drives._widen_error, _SERVOS, ("actuator_gear", "actuator_gainprm", "ctrl", "qpos"), ("actuator_biasprm",)
    ),
    "dead_zone_gate": Launch(
        gates._switch_servos,
        _SERVOS,
        ("actuator_gear", "ctrl", "qpos"),
        ("actuator_gainprm", "actuator_biasprm"),
    ),
    "external_force": Launch(forces._push_bodies, ("ids",), (), ("xfrc_applied",)),
    "joint_spring": Launch(forces._pull_joints, ("dofs", "qposadr"), ("qpos",), ("qfrc_applied",)),
    "load_friction": Launch(
        drives._add_load_friction, ("dofs", *_DRIVES), (*_TORQUE, "ctrl", "qpos", "qvel"), ("dof_frictionloss",)
    ),
    "residual_force": Launch(forces._push_joints, ("dofs",), (), ("qfrc_applied",)),
    "stribeck_friction": Launch(friction._add_stribeck_friction, ("dofs",), ("qvel",), ("dof_frictionloss",)),
    "torque_speed": Launch(drives._limit_torque_by_speed, ("joints", "dofs"), ("qvel",), ("jnt_actfrcrange",)),
}
"""Effects before every physics step."""

SENSORS = {
    "joint_offset": Launch(sensors._offset_positions, ("qposadr", "dofs")),
    "joint_offset_logged": Launch(sensors._offset_positions, ("qposadr", "dofs")),
    "sensor_scale": Launch(sensors._scale_numbers, ("read",)),
    "sensor_scale_logged": Launch(sensors._scale_numbers, ("read",)),
    "sensor_scale_position": Launch(sensors._scale_numbers, ("read",)),
    "time_scale_counted": Launch(sensors._scale_numbers, ("speeds",)),
}
"""Effects on what is measured of joints; all kernels have the same other arguments, see `nfpde.kernels.sensors`."""

_OF_DATA = ("ctrl", "qpos", "qvel", "qfrc_applied", "xfrc_applied")

Elements = dict[tuple[int, str], list[wp.array]]
"""By effect and place, what its kernel gets of each element."""

_PLACES = {"command": COMMANDS, "step": STEPS, "sensor": SENSORS}


class WarpEffects:
    """The effects of a simulator on a Warp device.

    Args:
        effects: bound effects.
        nbase: column of a parameter vector where their parameters begin.
        timestep: of the physics [s].

    Attributes:
        numbers: what the kernels get of each element, as `Elements`, on the host; see `look_up`.

    Raises:
        BadEffect: an effect without a kernel.
    """

    def __init__(self, effects: Sequence[Effect], nbase: int, timestep: float) -> None:
        for e in effects:
            _refuse_without_kernel(e)
        self.effects = tuple(effects)
        self.timestep = timestep
        self.numbers: dict[tuple[int, str], list[NDArray[Any]]] = {}
        self.columns = effect_columns(effects, nbase)
        self.nbase = nbase
        self.nvalue = sum(len(e.parameters) for e in effects)
        self.on_command = [i for i, e in enumerate(effects) if overrides(e, "command")]
        self.on_step = in_step_order(effects)
        self.on_sensor = [i for i, e in enumerate(effects) if e.name in SENSORS]
        self.step_fields = sorted(
            {f for i in self.on_step for f in STEPS[effects[i].name].changes if f not in _OF_DATA}
        )
        reads = {f for i in self.on_step for f in STEPS[effects[i].name].reads}
        self.read_fields = sorted(reads - {*_OF_DATA, *self.step_fields})

    def stage(self, xi: Array) -> tuple[Array, NDArray[np.int32]]:
        """Parameters of all effects (M, nvalue), and which effects act in each row (M, neffect)."""
        active = np.zeros((len(xi), max(1, len(self.effects))), np.int32)
        for i, (e, c) in enumerate(zip(self.effects, self.columns, strict=True)):
            active[:, i] = e.active(xi[:, c])
        return np.ascontiguousarray(xi[:, self.nbase :]), active

    def look_up(self, model: mujoco.MjModel) -> None:
        """Find the numbers of all elements in the model as the worlds share it, before anything runs."""
        self.numbers = {
            (i, place): [numbers_of(e, model, n) for n in known[e.name].elements]
            for i, e in enumerate(self.effects)
            for place, known in _PLACES.items()
            if e.name in known
        }

    def elements(self) -> Elements:
        """What the kernels get of each element, on Warp's current device."""
        return {place: [wp.array(n) for n in numbers] for place, numbers in self.numbers.items()}

    def alike(self) -> tuple[Hashable, ...]:
        """Equal for effects that the same captured work serves, with other numbers: all but where they act."""
        return tuple(
            (e.name, len(e.parameters), bool(e.recall_time()), *(self._sizes(i, place) for place in _PLACES))
            for i, e in enumerate(self.effects)
        )

    def change_commands(self, elements: Elements, staged: Staged, signal: wp.array) -> None:
        """Let the effects change the commands of all physics steps, (nworld, S, nu)."""
        for i in self.on_command:
            numbers = elements[i, "command"]
            wp.launch(
                COMMANDS[self.effects[i].name].kernel,
                dim=(signal.shape[0], numbers[0].size),
                inputs=[*staged.arrays(), *numbers, self._first(i), i, self.timestep],
                outputs=[signal],
            )

    def memories(self, elements: Elements, nworld: int) -> dict[int, wp.array]:
        """By effect, what its kernel keeps from step to step, on Warp's current device."""
        sizes = {i: STEPS[self.effects[i].name].memory for i in self.on_step}
        return {i: wp.zeros((nworld, elements[i, "step"][0].size, n), dtype=float) for i, n in sizes.items() if n}

    def forget(self, memories: dict[int, wp.array]) -> None:
        """Make what kernels keep unknown, at the start of windows."""
        for memory in memories.values():
            wp.launch(backlash._forget, dim=memory.shape, inputs=[], outputs=[memory])

    def before_step(
        self,
        elements: Elements,
        memories: dict[int, wp.array],
        staged: Staged,
        d: mjw.Data,
        fields: dict[str, wp.array],
        *,
        recalled: bool = False,
    ) -> None:
        """Let the effects act before a physics step, after fields and forces were put back.

        With `recalled`, those alone that recall what was before the window.
        """

        def array(name: str) -> wp.array:
            return getattr(d, name) if name in _OF_DATA else fields[name]

        for i in self.on_step:
            if recalled and not self.effects[i].recall_time():
                continue
            step, numbers = STEPS[self.effects[i].name], elements[i, "step"]
            wp.launch(
                step.kernel,
                dim=(d.nworld, numbers[0].size),
                inputs=[*map(array, step.reads), *staged.arrays(), *numbers, self._first(i), i],
                outputs=[*([memories[i]] if i in memories else []), *map(array, step.changes)],
            )

    def measure(
        self,
        elements: Elements,
        staged: Staged,
        step: wp.array,
        nq: int,
        states: wp.array,
        *,
        back: bool = False,
    ) -> None:
        """Turn simulated states into measured ones, or back; `states` (nworld, H, nx), of which one step is changed."""
        for i in self.on_sensor if back else reversed(self.on_sensor):
            numbers = elements[i, "sensor"]
            wp.launch(
                SENSORS[self.effects[i].name].kernel,
                dim=(states.shape[0], numbers[0].size),
                inputs=[*staged.arrays(), *numbers, self._first(i), step, nq, -1 if back else 1],
                outputs=[states],
            )

    def _sizes(self, effect: int, place: str) -> tuple[int, ...]:
        return tuple(numbers.size for numbers in self.numbers.get((effect, place), ()))

    def _first(self, effect: int) -> int:
        """Its first column of the staged values."""
        return self.columns[effect].start - self.nbase


def numbers_of(effect: Effect, model: mujoco.MjModel, name: str) -> NDArray[Any]:
    """What a kernel gets of each element of a bound effect.

    Args:
        effect: bound.
        model: as the worlds share it.
        name: an attribute with ids, of the effect (`dofs`) or of actuators it holds (`motors.ctrls`). Of actuators
            and commands also `low` and `high`, to which commands are clamped; of actuators `kind`, see
            `nfpde.kernels.drives`.
    """
    head, _, tail = name.rpartition(".")
    owner: Any = getattr(effect, head) if head else effect
    if tail in ("low", "high"):
        side, wide = (0, -np.inf) if tail == "low" else (1, np.inf)
        free = model.actuator_ctrllimited[owner.ctrls] == 0
        free |= bool(model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL))
        return np.where(free, wide, model.actuator_ctrlrange[owner.ctrls, side]).astype(np.float32)
    if tail == "kind":
        ids = owner.ids
        affine = int(mujoco.mjtGain.mjGAIN_AFFINE), int(mujoco.mjtBias.mjBIAS_AFFINE)
        bits = (model.actuator_gaintype[ids] == affine[0]) + 2 * (model.actuator_biastype[ids] == affine[1])
        bits = bits + 4 * (model.actuator_forcelimited[ids] != 0) + 8 * (model.jnt_actfrclimited[owner.joints] != 0)
        bits = bits + 16 * switched_off(model, ids)
        return bits.astype(np.int32)
    numbers = np.asarray(getattr(owner, tail))
    return numbers.astype(np.float32 if numbers.dtype.kind == "f" else np.int32)


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
