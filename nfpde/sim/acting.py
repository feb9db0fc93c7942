"""Effects at work: where their parameters stand, and what they do to the rows of one call."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.effects import Effect, World, effects_in
from nfpde.effects.effect import overrides
from nfpde.errors import BadEffect
from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]


def split_space(space: ParameterSpace | None) -> tuple[ParameterSpace | None, list[Effect]]:
    """Separate a space into model fields and the effects whose parameters it holds, not bound.

    Raises:
        BadEffect: parameters of effects that do not follow all others, or not in order.
        BadParameter: no space, and nothing that makes one.
    """
    if space is None:
        return None, []
    if not isinstance(space, ParameterSpace):  # a list of parameters is as good as a space
        space = ParameterSpace(space)
    inside = effects_in(space)
    of_effects = [(p.field, p.target) for e in inside for p in e.parameters]
    base = [p for p in space if (p.field, p.target) not in of_effects]
    if [(p.field, p.target) for p in space] != [*((p.field, p.target) for p in base), *of_effects]:
        raise BadEffect("parameters of effects must follow all others in a space, each effect's in its own order")
    return (ParameterSpace(base) if base else None), inside


def checked_effects(effects: object) -> list[Effect]:
    """Effects that were given as a list, or refuse what is none.

    Raises:
        BadEffect: something else, with how to write it.
    """
    if isinstance(effects, Effect):
        raise BadEffect(
            f"effects must be a list, got the effect {effects.name} alone; write [effect({effects.name!r}, ...)]"
        )
    if isinstance(effects, str) or not isinstance(effects, Iterable):
        raise BadEffect(f"effects must be a list of effects, got {effects!r}; write [effect(name, target, ...)]")
    found = list(effects)
    for i, e in enumerate(found):
        if not isinstance(e, Effect):
            named = repr(e) if isinstance(e, str) else "name"
            raise BadEffect(
                f"effects[{i}] is no effect, got {e!r}; write effect({named}, target, ...), with the function of "
                "nfpde.effects and bounds for its parameters"
            )
    return found


def effect_columns(effects: Sequence[Effect], first: int) -> list[slice]:
    """Where each effect's parameters stand in a parameter vector, one effect's after the other's from `first` on."""
    ends = first + np.cumsum([0, *(len(e.parameters) for e in effects)])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def in_step_order(effects: Sequence[Effect]) -> list[int]:
    """Which effects act before a physics step, in the order in which they do, whatever order they are listed in."""
    return sorted((i for i, e in enumerate(effects) if overrides(e, "step")), key=lambda i: effects[i].step_order)


class BoundEffects:
    """Effects bound to a model, and the columns of their parameters.

    Args:
        model: the nominal model.
        effects: bound effects.
        first: column of a parameter vector where their parameters begin, one effect's after the other's.
    """

    def __init__(self, model: mujoco.MjModel, effects: Sequence[Effect], first: int) -> None:
        self.model = model
        self.effects = tuple(effects)
        self._columns = effect_columns(effects, first)
        self.on_command = [i for i, e in enumerate(effects) if overrides(e, "command")]
        self.on_step = in_step_order(effects)
        self.step_fields = sorted({f for i in self.on_step for f in effects[i].step_fields})
        self.memory_time = self._memory_time()
        self.recall_time = max((effects[i].recall_time() for i in self.on_step), default=0.0)

    def _memory_time(self) -> float:
        """How far back [s] commands matter: effects in series on one command add up."""
        behind = np.zeros(max(1, self.model.nu))
        for e in self.effects:
            behind[e.ctrls if e.kind == "actuator" else slice(None)] += e.memory_time()
        return float(behind.max())

    def on_rows(self, xi: Array) -> RowEffects:
        """The effects with the parameters of R rows, (R, D)."""
        return RowEffects(self, [xi[:, c] for c in self._columns])


class RowEffects:
    """What the effects do to the R rows of one call; `values[i]` holds the parameters (R, P) of effect i."""

    def __init__(self, bound: BoundEffects, values: list[Array]) -> None:
        self._bound = bound
        self._values = values
        self._on_command = self._acting(bound.on_command)
        self._on_step = self._acting(bound.on_step)

    @property
    def between_steps(self) -> bool:
        """Whether any row needs `delivered` or `before_step` at every physics step."""
        return bool(self._on_command or self._on_step)

    def to_simulated(self, start: Array) -> Array:
        """States of the simulation behind measured ones, (R, nx)."""
        for e, values in zip(self._bound.effects, self._values, strict=True):
            start = e.to_simulated(start, values)
        return start

    def to_measured(self, states: Array) -> Array:
        """What sensors report of simulated states, (R, H, nx)."""
        for e, values in zip(reversed(self._bound.effects), reversed(self._values), strict=True):
            states = e.to_measured(states, values[:, None, :])
        return states

    def commands(
        self, windows: Windows, window: NDArray[np.intp], history: int, nsub: int, past: int = 0
    ) -> Array | None:
        """Commands of every physics step as they reach the actuators; None where nothing changes them.

        Args:
            windows: the windows.
            window: which of them each row replays, (R,).
            history: commands from before the start that matter.
            nsub: physics steps in a control step.
            past: control steps before the start whose commands are wanted too, at most `history`.

        Returns:
            (R, (past + H) nsub, nu).
        """
        if not self._on_command:
            return None
        before = windows.history[:, windows.nhistory - history :]
        signal = np.concatenate([before[window], windows.ctrl[window]], axis=1).repeat(nsub, axis=1)
        return self.delivered(signal)[:, (history - past) * nsub :]

    def delivered(self, signal: Array) -> Array:
        """Commands sent at every physics step as they reach the actuators, (R, S, nu); `signal` is overwritten."""
        for e, rows, values in self._on_command:
            signal[rows] = e.command(signal[rows], values, self._bound.model.opt.timestep)
        return signal

    def before_steps(self, batch: mujoco.batch.Batch, n: int) -> BeforeStep | None:
        """`before_step` for the first n simulations of a batch; None if no effect acts there."""
        if not self._on_step:
            return None
        state = (batch.bind(f)[:n] for f in ("qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied"))
        fields = {f: batch.expand(f)[:n] for f in self._bound.step_fields}
        return self.before_step(World(self._bound.model, *state, fields=fields))

    def before_step(self, world: World) -> BeforeStep:
        """What to call before every physics step of a world whose fields hold the rows' own values."""
        return BeforeStep(world, {f: v.copy() for f, v in world.fields.items()}, self._on_step)

    def _acting(self, which: list[int]) -> list[tuple[Effect, NDArray[np.intp], Array]]:
        """Effects that are not neutral in all rows, with the rows where they are not and their parameters there."""
        found = []
        for i in which:
            e, values = self._bound.effects[i], self._values[i]
            rows = np.flatnonzero(e.active(values))
            if len(rows):
                found.append((e, rows, values[rows]))
        return found


@dataclass
class BeforeStep:
    """Lets effects act before a physics step.

    world: what they see and change
    fields: the rows' own values of the model fields that effects change, put back before every step
    acting: effects, rows, parameters
    own_forces: `qfrc_applied` and `xfrc_applied` of whoever else pushes, to which those of effects are added
    """

    world: World
    fields: dict[str, Array]
    acting: list[tuple[Effect, NDArray[np.intp], Array]]
    own_forces: tuple[Array | float, Array | float] = (0.0, 0.0)

    @property
    def recall_time(self) -> float:
        """How far back [s] effects are to be taken through the recorded motion."""
        return max((e.recall_time() for e, _, _ in self.acting), default=0.0)

    def __call__(self) -> None:
        """Start from the rows' own fields and the forces of others, and let every effect add its part."""
        self._act(self.acting)

    def recall(self, known: NDArray[np.bool_]) -> None:
        """The same in the recorded motion before a window, for effects that recall it, in rows (R,) where it is known.

        What they do to fields and forces is undone at the next call.
        """
        chosen = [(e, np.isin(rows, np.flatnonzero(known)), rows, v) for e, rows, v in self.acting if e.recall_time()]
        self._act([(e, rows[some], values[some]) for e, some, rows, values in chosen if some.any()])

    def _act(self, acting: list[tuple[Effect, NDArray[np.intp], Array]]) -> None:
        for name, own in self.fields.items():
            self.world.fields[name][...] = own
        self.world.qfrc_applied[...], self.world.xfrc_applied[...] = self.own_forces
        for e, rows, values in acting:
            e.step(self.world, rows, values)
