"""What an effect is: a piece of physics that the nominal model lacks, with a few parameters of its own.

An effect may act in four places, and overrides the method of each place where it does:

=============== ==========================================================================================
`write_model`   fields of the mjModel, once per parameter vector (MuJoCo knows the mechanism)
`command`       the commands on their way to the actuators, at every physics step, with the past commands
`step`          forces, or fields that follow the state, before every physics step
`measurement`   what the sensors report: `to_measured` and its inverse `to_simulated`
=============== ==========================================================================================

With its parameters at their neutral values an effect does nothing, which is how rows of one batch carry different
effects: every row has all the parameters, and those of the effects it does not have are neutral.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.effects.scales import DataScales
from nfpde.elements import actuator_ctrls, element_ids, element_names, joint_dofs, joint_qpos
from nfpde.errors import BadEffect
from nfpde.parameters import Parameter, Target

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
Bounds = dict[str, tuple[float, float]]

EVERY = -2
"""Stands for all elements of a kind at once in `Effect.bounds_for`."""

_SHARES, _MIRRORED = (0.01, 0.04, 0.15, 0.5), (0.01, 0.04)
"""Shares of the way to a bound that are tried first, and to the other bound: where motion is unstable, or something is
touched, only small changes are linear, and their mirror images need not be what the other side does."""


@dataclass(frozen=True)
class Quantity:
    """One parameter of an effect: its unit, the values physics allows, and the value at which it does nothing."""

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    """Where the effect vanishes; for a parameter that only shapes an effect (a speed scale), any typical value."""
    shape_only: bool = False
    """True for a parameter whose value alone cannot make the effect neutral or not."""
    log: bool = False
    """True for a ratio or a time scale that varies over decades: screened on a logarithmic scale."""


@dataclass
class World:
    """What an effect sees and changes before every physics step; R rows are simulated side by side.

    qpos: positions                                          (R, nq)
    qvel: velocities                                         (R, nv)
    ctrl: commands of this physics step                      (R, nu)
    qfrc_applied: forces of effects, to be added to          (R, nv)
    xfrc_applied: forces and torques of effects on bodies, at their centres of mass, in the world's frame, to be added
      to                                                     (R, nbody, 6)
    fields: model fields an effect named in `step_fields`,
      reset before every step to the row's own, to be changed (R, ...)
    memory: what an effect keeps from step to step, empty at the start of every window and, for an effect that recalls,
      of the recorded motion before it
    """

    model: mujoco.MjModel
    qpos: Array
    qvel: Array
    ctrl: Array
    qfrc_applied: Array
    xfrc_applied: Array
    fields: dict[str, Array] = field(default_factory=dict)
    memory: dict[object, Array] = field(default_factory=dict)


class Effect:
    """Base of all effects; see the module's text for the four places where one may act.

    Args:
        target: the element it acts on: name, id or `#<id>`; None for an effect on the whole robot or world.
        **bounds: (low, high) for each parameter that the fit may vary, within what physics allows. Parameters
            without default bounds need them.

    Raises:
        BadEffect: unknown parameter, bounds missing or outside what physics allows.
    """

    name: ClassVar[str]
    kind: ClassVar[str | None]
    """Kind of element it acts on (`joint`, `actuator`, `body`), or None."""
    quantities: tuple[Quantity, ...]
    """Its parameters; an effect whose neutral values are the model's own has others once it is bound."""
    default_bounds: ClassVar[dict[str, tuple[float, float]]] = {}
    step_fields: ClassVar[tuple[str, ...]] = ()
    """mjModel fields that `step` writes."""
    write_order: ClassVar[int] = 0
    """`write_model` of lower ones runs first: what builds on fields that others change is 1."""
    step_order: ClassVar[int] = 0
    """`step` of lower ones runs first, in whatever order effects are listed: what changes an actuator's force or its
    limits is below 0, what asks for that force above, and what takes all friction behind a play comes last."""
    taken_fields: ClassVar[tuple[str, ...]] = ()
    """mjModel fields of its actuators that it takes from the nominal model: no parameter may change them beside it."""
    sentence: ClassVar[str]
    """What it is, for a roboticist."""
    live: ClassVar[bool] = True
    """Whether it can act in an environment, where what it remembers of commands begins anew every step."""
    forgets: ClassVar[bool] = True
    """Whether commands from before `memory_time` never matter; else all that are known are gone through."""
    says: ClassVar[str] = ""
    """The effect that this is another reading of, where engineers mean different things by one name; "" for none."""
    confounders: ClassVar[tuple[str, ...]] = ()
    """Effects that explain much of the same data."""
    whole: ClassVar[str] = "all"
    """What an effect without a target acts on, in reports."""
    threshold: ClassVar[bool] = False
    """Whether it acts only from a torque, a command or a play on that its values name, and does nothing short of it."""

    ids: Rows
    dofs: Rows
    qposadr: Rows
    ctrls: Rows

    def __init__(self, target: Target = None, **bounds: Sequence[float]) -> None:
        if self.kind is None and target is not None:
            raise BadEffect(f"{self.name} acts on the whole robot and takes no target, got {target!r}")
        if self.kind is not None and target is None:
            raise BadEffect(f"{self.name} needs a target: the {self.kind} it acts on")
        self.target = tuple(target) if isinstance(target, list) else target
        known = [q.name for q in self.quantities]
        unknown = sorted(set(bounds) - set(known))
        if unknown:
            raise BadEffect(f"{self.name} has no parameter {unknown[0]!r}; it has: {', '.join(known)}")
        self.parameters = tuple(self._parameter(q, bounds.get(q.name)) for q in self.quantities)

    def _parameter(self, q: Quantity, bounds: Sequence[float] | None) -> Parameter:
        if bounds is None:
            bounds = self.default_bounds.get(q.name)
        if not isinstance(bounds, Sequence | np.ndarray) or isinstance(bounds, str) or len(bounds) != 2:
            raise BadEffect(
                f"{self.name}: give bounds for {q.name}, as {q.name}=(low, high) in {q.unit}"
                + ("" if bounds is None else f"; got {bounds!r}")
            )
        low, high = bounds
        parameter = Parameter(f"{self.name}.{q.name}", self.target, low, high, unit=q.unit)
        if not (q.low <= low and high <= q.high):
            raise BadEffect(
                f"{self.name}: {q.name} must stay within [{q.low:g}, {q.high:g}] {q.unit}, got ({low:g}, {high:g})"
            )
        return parameter

    def bind(self, model: mujoco.MjModel) -> Self:
        """A copy that knows its target's `ids`, and a joint's `dofs` and `qposadr`, or an actuator's `ctrls`.

        Raises:
            BadEffect: the model has no such element, or the effect cannot act on it.
        """
        bound = copy.copy(self)
        if self.kind is not None:
            bound.ids = element_ids(model, self.kind, self.target, self.name, BadEffect)
        if self.kind == "joint":
            bound.dofs = joint_dofs(model, bound.ids)
            bound.qposadr = joint_qpos(model, bound.ids)
        if self.kind == "actuator":
            bound.ctrls = actuator_ctrls(model, bound.ids)
        return bound

    @property
    def called(self) -> str:
        """Its name in reports: that of the effect of which it is a reading, or its own."""
        return self.says or self.name

    @property
    def place(self) -> str:
        """What the effect acts on, in reports: the target's name, or what stands for all of them."""
        if self.target is None:
            return self.whole
        return "all" if self.target == "*" else ", ".join(map(str, np.atleast_1d(np.array(self.target, dtype=object))))

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Bounds with which a diagnosis should try the effect on an element, or None where it makes no sense.

        What of them physics does not allow is not tried. The base gives `default_bounds`, if they cover all parameters.

        Args:
            model: The nominal model.
            element: Id of the element; -1 for an effect without target, `EVERY` for all elements of the kind at once.
            scales: Typical magnitudes of the recordings: sizes are counted in these, never in absolute numbers.
        """
        complete = all(q.name in cls.default_bounds for q in cls.quantities)
        return dict(cls.default_bounds) if complete and element != EVERY else None

    @classmethod
    def candidates(cls, model: mujoco.MjModel, scales: DataScales) -> list[Effect]:
        """The effect on every element on which a diagnosis should try it."""
        if cls.kind is None:
            targets: list[tuple[Target, int]] = [(None, -1)]
        else:
            names = element_names(model, cls.kind)
            targets = [(name, i) for i, name in enumerate(names)]
            targets += [("*", EVERY)] if len(names) > 1 else []
        found = []
        for target, element in targets:
            wanted = cls.bounds_for(model, element, scales)
            bounds = None if wanted is None else cls._allowed(wanted)
            if bounds is not None:
                found.append(cls(target, **bounds))
        return found

    @classmethod
    def _allowed(cls, bounds: Bounds) -> Bounds | None:
        """The part of bounds that physics allows, as unusual magnitudes lead beyond; None where none is left."""
        allowed = dict(bounds)
        for q in cls.quantities:
            low, high = bounds.get(q.name, (q.low, q.high))
            if high <= q.low or low >= q.high:
                return None
            if q.name in bounds:
                allowed[q.name] = (max(low, q.low), min(high, q.high))
        return allowed

    def screened(self, scales: DataScales) -> Array:
        """Parameter values to try first, (K, P), inside the bounds.

        The base moves one parameter at a time from neutral, by 1 %, 4 %, 15 % and 50 % of the way to its upper bound
        (or to its lower one, if neutral is the upper), and by 1 % and 4 % to the other side, if there is one;
        parameters that only shape the effect stay in the middle of theirs.
        """
        low, high = (np.array([getattr(p, side) for p in self.parameters]) for side in ("low", "high"))
        start = np.array([q.neutral for q in self.quantities])
        for i, q in enumerate(self.quantities):
            if q.shape_only:
                start[i] = np.sqrt(low[i] * high[i]) if q.log and low[i] > 0 else 0.5 * (low[i] + high[i])
        rows = []
        for i, q in enumerate(self.quantities):
            if q.shape_only:
                continue
            below, above = (not np.isclose(end, q.neutral) for end in (low[i], high[i]))
            sides = [(high[i] if above else low[i], _SHARES)]
            sides += [(low[i], _MIRRORED)] if above and below and low[i] < q.neutral else []
            for end, share in ((end, share) for end, shares in sides for share in shares):
                row = start.copy()
                if q.log and min(end, q.neutral) > 0:
                    row[i] = q.neutral * (end / q.neutral) ** (share**0.5)
                else:
                    row[i] = q.neutral + share * (end - q.neutral)
                rows.append(row)
        margin = 1e-6 * (high - low)
        return np.clip(np.array(rows), low + margin, high - margin)

    def together(self, values: Array, shares: Array) -> Array:
        """Values (P,) whose changes are about the sum of those of several values (K, P), each by its share (K,).

        The base adds up distances from neutral; parameters that only shape the effect are those of the largest share.
        """
        neutral = np.array([q.neutral for q in self.quantities])
        shape = [i for i, q in enumerate(self.quantities) if q.shape_only]
        added = neutral + shares @ (values - neutral)
        added[shape] = values[int(np.argmax(shares)), shape]
        return added

    def straightened(self, values: Array) -> Array:
        """Coordinates (..., P) of values (..., P) in which what the effect does is closer to linear.

        The base takes the values themselves.
        """
        return values

    def bent(self, coordinates: Array) -> Array:
        """Values (..., P), inside the bounds, of coordinates (..., P)."""
        return coordinates

    def straight_bounds(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates (P,)."""
        low, high = (np.array([getattr(p, side) for p in self.parameters]) for side in ("low", "high"))
        return low, high

    def active(self, values: Array) -> NDArray[np.bool_]:
        """Which rows of values (R, P) differ from neutral, (R,); only there do `command` and `step` run."""
        decisive = [i for i, q in enumerate(self.quantities) if not q.shape_only]
        neutral = np.array([self.quantities[i].neutral for i in decisive])
        return (values[:, decisive] != neutral).any(1)

    def actuators(self) -> Rows:
        """Ids of the actuators whose commands or forces it deals with; of a bound effect.

        The base knows of its target; an effect on anything else that names `taken_fields` says which they are.
        """
        return self.ids if self.kind == "actuator" else np.zeros(0, dtype=np.intp)

    def memory_time(self) -> float:
        """How far back [s] the commands matter, at most, within the bounds of the parameters."""
        return 0.0

    def recall_time(self) -> float:
        """How far back [s] `step` is to be taken through the recorded motion, for its memory to be right at the start.

        Forces that it gives there, and fields that it changes, come to nothing.
        """
        return 0.0

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Change fields of the model for one parameter vector; values (P,). mj_setConst runs afterwards."""

    def command(self, ctrl: Array, values: Array, timestep: float) -> Array:
        """Commands as they reach the actuators.

        Args:
            ctrl: commands at every physics step, those before the window's start included, (R, S, nu).
            values: the rows' parameters, (R, P).
            timestep: of the physics [s].

        Returns:
            The changed commands, (R, S, nu).
        """
        return ctrl

    def step(self, world: World, rows: Rows, values: Array) -> None:
        """Act before a physics step on `rows` of the world (n,), with their parameters (n, P)."""

    def to_simulated(self, state: Array, values: Array) -> Array:
        """State of the simulation (..., nq+nv) behind a measured one; values (..., P)."""
        return state

    def to_measured(self, state: Array, values: Array) -> Array:
        """What the sensors report (..., nq+nv) of a state of the simulation; values (..., P)."""
        return state


def overrides(effect: Effect, method: str) -> bool:
    """Whether the effect's class overrides a method of `Effect`."""
    return getattr(type(effect), method) is not getattr(Effect, method)
