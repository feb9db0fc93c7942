"""Replaying windows with a set of effects: residuals by degree of freedom, at the horizons to compare at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.effects import Effect, Quantity, World
from nfpde.effects.effect import overrides
from nfpde.gap.identity import identity_of
from nfpde.gap.inertia import inertia_of
from nfpde.gap.recall import Recall
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device, MujocoSimulator, make_simulator, runs_on

Array = NDArray[np.float64]

_MEMORY = 1 << 24
"""Numbers of predicted states held at once."""

_NUDGE = 1e-6
"""Share of the bounds over which coordinates are differenced."""


def residual_force(model: mujoco.MjModel) -> Effect:
    """A constant generalized force on every degree of freedom, for the sake of comparison; no effect of the library."""

    def step(self: Effect, world: World, rows: NDArray[np.intp], values: Array) -> None:
        world.qfrc_applied[rows] += values

    names = [f"f{i}" for i in range(model.nv)]
    members = {
        "name": "residual_force",
        "kind": None,
        "quantities": tuple(Quantity(n, "Nm", -math.inf, math.inf, neutral=0.0) for n in names),
        "default_bounds": dict.fromkeys(names, (-1e6, 1e6)),
        "sentence": "A force of unknown origin.",
        "step": step,
        "dofs": np.arange(model.nv),
        "__doc__": "A constant generalized force on every degree of freedom.",
    }
    return type("ResidualForceEffect", (Effect,), members)()


class Replay:
    """A model with free base parameters and effects, ready to replay windows.

    Args:
        model: The nominal model.
        space: The free parameters; None: there are none. For each mass among them whose bodies turn one more is free:
            how far their inertias follow (`Inertia`).
        effects: The effects.
        nthread: Threads; 0 takes all cores this process may use.
        device: Where to simulate, see `make_simulator`.
        recall: What other replays have predicted; None: this one's alone.

    Attributes:
        space: the free parameters as given.
        low, high: bounds of the free parameters: base parameters first, then those of the effects (D,).
        nbase: number of base parameters.
        effects: the effects.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        space: ParameterSpace | None,
        effects: Sequence[Effect],
        nthread: int = 0,
        device: Device = "cpu",
        recall: Recall | None = None,
    ) -> None:
        self.effects = tuple(effects)
        self._recall = Recall() if recall is None else recall
        self.space, beside = space, list(inertia_of(model, space).values())
        acting = [*beside, *effects, residual_force(model)]
        self.sim = make_simulator(model, space, acting, device=device, check_influence=False)
        if isinstance(self.sim, MujocoSimulator) and nthread:
            self.sim.nthread = nthread
        where = "cpu" if isinstance(self.sim, MujocoSimulator) else runs_on(self.sim)
        self._who = identity_of(model, space, effects, where)
        self.nv = model.nv
        self.nbase = (0 if space is None else len(space)) + sum(len(e.parameters) for e in beside)
        self.low, self.high = self.sim.space.low[: -self.nv], self.sim.space.high[: -self.nv]
        self.parameters = list(self.sim.space)[: -self.nv]

    @property
    def nfree(self) -> int:
        """Number of free parameters D."""
        return len(self.low)

    def columns(self, effect: int) -> slice:
        """Where the parameters of an effect stand."""
        first = self.nbase + sum(len(e.parameters) for e in self.effects[:effect])
        return slice(first, first + len(self.effects[effect].parameters))

    def inward(self, xi: Array) -> Array:
        """Shares of the bounds (..., D), 0 to 1, of free parameters (..., D), in effects' straightened coordinates."""
        low, high = self._straight_bounds
        return np.clip((self._turned(xi, "straightened") - low) / (high - low), 0.0, 1.0)

    def outward(self, u: Array) -> Array:
        """Free parameters (..., D), inside their bounds, of shares (..., D)."""
        low, high = self._straight_bounds
        return np.clip(self._turned(low + u * (high - low), "bent"), self.low, self.high)

    def outward_slopes(self, xi: Array) -> Array:
        """How free parameters change with the shares, at free parameters (D,): (D, D)."""
        u, step = self.inward(xi), _NUDGE * np.eye(len(xi))
        above, below = np.minimum(u + step, 1.0), np.maximum(u - step, 0.0)
        return ((self.outward(above) - self.outward(below)) / np.diag(above - below)[:, None]).T

    def _turned(self, at: Array, method: str) -> Array:
        for index, effect in enumerate(self.effects):
            if overrides(effect, method):
                columns = self.columns(index)
                at = at.copy()
                at[..., columns] = getattr(effect, method)(at[..., columns])
        return at

    @cached_property
    def _straight_bounds(self) -> tuple[Array, Array]:
        low, high = self.low.copy(), self.high.copy()
        for index, effect in enumerate(self.effects):
            low[self.columns(index)], high[self.columns(index)] = effect.straight_bounds()
        return low, high

    def predict(
        self, xi: Array, windows: Windows, force: Array | None = None, steps: NDArray[np.intp] | None = None
    ) -> Array:
        """Predicted measurements (M, N, H, nx) of free parameters (M, D).

        Args:
            xi: Free parameters.
            windows: What is predicted.
            force: Generalized forces (M, nv) beside; None: none.
            steps: After which control steps, from 0 on; None: after each.
        """
        force = np.zeros((len(xi), self.nv)) if force is None else force
        rows = slice(None) if steps is None else steps

        def simulate(some: Array) -> Array:
            return self.sim.predict(some, windows)[:, :, rows]

        def read(count: int) -> None:
            taken = len(windows) * windows.horizon * self.sim.substeps(windows.control_dt)
            self.sim.simulated_steps += count * taken

        who = self._who + (b"" if steps is None else steps.tobytes())
        return self._recall.predict(who, simulate, np.hstack([xi, force]), windows, read)

    def residuals(self, xi: Array, windows: Windows, horizons: Sequence[int], force: Array | None = None) -> Array:
        """Predicted - measured by degree of freedom: free parameters (M, D) to (M, N, nv, 2 horizons).

        The channels of a degree of freedom are its position at every horizon, then its velocity. Windows that diverge
        are NaN.
        """
        size = max(1, _MEMORY // (len(windows) * windows.horizon * self.sim.states.nx))
        steps = np.array(horizons) - 1
        parts = []
        for start in range(0, len(xi), size):
            part = slice(start, start + size)
            states = self.predict(xi[part], windows, None if force is None else force[part], steps)
            parts.append(self.by_dof(self.sim.states.difference(states, windows.target[:, steps])))
        return np.concatenate(parts)

    def moved(self, windows: Windows, horizons: Sequence[int]) -> Array:
        """By how much the channels change over the horizons, as residuals (N, nv, 2 horizons)."""
        steps = np.array(horizons) - 1
        return self.by_dof(self.sim.states.difference(windows.target[:, steps], windows.state[:, :1]))

    def by_dof(self, difference: Array) -> Array:
        """Differences (..., h, 2 nv) to (..., nv, 2 h): positions at every horizon, then velocities."""
        nv = self.nv
        return np.concatenate([difference[..., :nv], difference[..., nv:]], axis=-2).swapaxes(-1, -2)


def started_beside(replay: Replay, windows: Windows, shift: Array) -> Windows:
    """The windows with their starts moved by (2 nv,) or (N, 2 nv), positions in tangent space."""
    start = windows.state[:, 0]
    moved = replay.sim.states.moved(start, np.broadcast_to(shift, (len(start), 2 * replay.nv)))
    return replace(windows, state=np.concatenate([moved[:, None], windows.state[:, 1:]], axis=1))


def displaced(
    replay: Replay, xi: Array, windows: Windows, horizons: Sequence[int], size: Array, forces: Array | None = None
) -> Array:
    """How predictions change where the start is measured wrong, one channel at a time, by so much to either side.

    A contact opens one way and presses the other: one side does not tell what the other does.

    Args:
        replay: The model that predicts.
        xi: Its free parameters (D,).
        windows: Of recordings (N).
        horizons: Control steps after which to look (h).
        size: Of the error in each channel (2 nv,); none is simulated where it is zero.
        forces: Generalized forces (models, nv), one model after the other for the channels; None: no force.

    Returns:
        Changes (2, 2 nv, N, h, 2 nv), up first, by the channel in error; zero in windows that diverge.
    """
    steps, channels = np.array(horizons) - 1, len(size)
    forces = np.zeros((1, replay.nv)) if forces is None else forces
    there = [replay.predict(xi[None], windows, force[None], steps)[0] for force in forces]
    change = np.zeros((2, channels, *there[0].shape[:2], channels))
    for channel in np.flatnonzero(size > 0):
        which = channel % len(forces)
        for side, sign in enumerate((1.0, -1.0)):
            moved = started_beside(replay, windows, sign * size * (np.arange(channels) == channel))
            ends = replay.predict(xi[None], moved, forces[which][None], steps)[0]
            change[side, channel] = replay.sim.states.difference(ends, there[which])
    return np.nan_to_num(change, posinf=0.0, neginf=0.0)
