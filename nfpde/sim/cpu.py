"""The reference simulator: plain MuJoCo in double precision on all CPU cores."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.effects import Effect, World, effects_in
from nfpde.effects.effect import overrides
from nfpde.errors import BadEffect, BadInput, BadParameter
from nfpde.parameters import ParameterSpace
from nfpde.sim.model import load_model
from nfpde.sim.probe import refuse_inert
from nfpde.sim.simulator import CHUNK_ROWS, Array, Simulator
from nfpde.sim.states import StateSpace
from nfpde.sim.writer import ModelWriter, get_field


class MujocoSimulator(Simulator):
    """MuJoCo on the CPU (`mujoco.batch`): every row of a call is one simulation, all of them side by side.

    Args:
        model: path of an MJCF or URDF file, or a compiled mjModel; see `load_model` for what is changed in it.
        space: the parameters. Parameters of effects (`coulomb_friction.torque`) may be among them, as they are in
            the space of a saved distribution; None where only effects are unknown.
        effects: physics the model lacks; their parameters are appended to the space.
        nthread: threads; 0 takes all cores this process may use.
        check_influence: refuse parameters that change nothing, found by simulating; switch it off for parameters
            that only matter in states which random motion does not reach.

    Raises:
        BadModel, BadParameter, BadEffect: what cannot be used, and why.
    """

    def __init__(
        self,
        model: str | Path | mujoco.MjModel,
        space: ParameterSpace | None = None,
        effects: Sequence[Effect] = (),
        *,
        nthread: int = 0,
        check_influence: bool = True,
    ) -> None:
        self.model = load_model(model)
        base, inside = _split(space)
        if base is None and not inside and not effects:
            raise BadParameter("give a parameter space or at least one effect; there is nothing to estimate")
        self.effects = [e.bind(self.model) for e in [*inside, *effects]]
        self.space = ParameterSpace([*(base or ()), *(p for e in self.effects for p in e.parameters)])
        self.states = StateSpace.of_model(self.model)
        self.writer = ModelWriter(self.model, base, self.effects)
        self.memory_time = max((e.memory_time() for e in self.effects), default=0.0)
        self.nthread = nthread or len(os.sched_getaffinity(0))
        self._columns = dict(zip(map(id, self.effects), _column_slices(len(base or ()), self.effects), strict=True))
        self._on_command = [e for e in self.effects if overrides(e, "command")]
        self._on_step = [e for e in self.effects if overrides(e, "step")]
        self._on_sensor = [e for e in self.effects if overrides(e, "to_measured") or overrides(e, "to_simulated")]
        self._step_fields = sorted({f for e in self._on_step for f in e.step_fields})
        self._batch: mujoco.batch.Batch | None = None
        if check_influence:
            refuse_inert(self, self.model)

    def rollout(self, xi: Array, windows: Windows, vector: NDArray[np.intp], window: NDArray[np.intp]) -> Array:
        """See `Simulator.rollout`; more rows than fit in memory at once are simulated in chunks.

        Raises:
            BadInput: the control step is no multiple of the model's timestep, or the command sizes differ.
        """
        nsub = self.substeps(windows.control_dt)
        if windows.ctrl.shape[2] != self.model.nu:
            raise BadInput(f"the windows have nu={windows.ctrl.shape[2]} commands, the model nu={self.model.nu}")
        fields = self.writer.rows(xi)
        out = np.empty((len(vector), windows.horizon, self.states.nx))
        for start in range(0, len(vector), CHUNK_ROWS):
            part = slice(start, start + CHUNK_ROWS)
            out[part] = self._simulate(xi, fields, windows, vector[part], window[part], nsub)
        self.simulated_steps += len(vector) * windows.horizon * nsub
        return out

    def substeps(self, control_dt: float) -> int:
        """Physics steps in a control step of control_dt [s].

        Raises:
            BadInput: it is no multiple of the model's timestep.
        """
        timestep = self.model.opt.timestep
        nsub = round(control_dt / timestep)
        if nsub < 1 or abs(control_dt - nsub * timestep) > 1e-6 * control_dt:
            raise BadInput(
                f"the control step {control_dt:g} s is no multiple of the model's timestep {timestep:g} s; set the "
                f"timestep to {control_dt / max(1, nsub):g} s or resample the data"
            )
        return nsub

    def _simulate(
        self,
        xi: Array,
        fields: dict[str, Array],
        windows: Windows,
        vector: NDArray[np.intp],
        window: NDArray[np.intp],
        nsub: int,
    ) -> Array:
        n, horizon = len(vector), windows.horizon
        batch = self._prepared_batch(n)
        ids = np.arange(n)
        for name, values in fields.items():
            batch.expand(name)[:n] = values[vector]
        values = {id(e): xi[vector, self._columns[id(e)]] for e in self.effects}
        start = windows.state[window, 0]
        for e in self._on_sensor:
            start = e.to_simulated(start, values[id(e)])
        qpos, qvel, ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        qpos[:n], qvel[:n] = start[:, : self.states.nq], start[:, self.states.nq :]
        signal = self._commands(windows, window, values, nsub)
        world, acting = self._world(batch, fields, vector, values, n)
        fine = signal is not None or bool(acting)
        out = np.empty((n, horizon, self.states.nx))
        broken = np.zeros((n, horizon), bool)
        for h in range(horizon):
            ctrl[:n] = windows.ctrl[window, h]
            for k in range(nsub if fine else 1):
                if signal is not None:
                    ctrl[:n] = signal[:, h * nsub + k]
                if world is not None:
                    self._act(world, acting)
                batch.step(ids, nstep=1 if fine else nsub)
            out[:, h, : self.states.nq], out[:, h, self.states.nq :] = qpos[:n], qvel[:n]
            broken[:, h] = (batch.warning[:n, :, 1] > 0)[:, _FATAL].any(1)
        for e in reversed(self._on_sensor):
            out = e.to_measured(out, values[id(e)][:, None, :])
        broken |= ~np.isfinite(out).all(2)
        out[np.logical_or.accumulate(broken, axis=1)] = np.nan
        return out

    def _prepared_batch(self, n: int) -> mujoco.batch.Batch:
        """The batch, with its first n simulations at rest at time 0 and without a warm start."""
        batch = self._batch
        if batch is None or batch.nsim < n:
            size = min(CHUNK_ROWS, 1 << (n - 1).bit_length())
            self._batch = batch = mujoco.batch.Batch(self.model, size, self.nthread)
            self._rest = batch.state[0].copy()
            for name in {*self.writer.fields, *self._step_fields}:
                batch.expand(name)
        batch.state[:n] = self._rest
        batch.warning[:n] = 0
        return batch

    def _commands(
        self, windows: Windows, window: NDArray[np.intp], values: dict[int, Array], nsub: int
    ) -> Array | None:
        """Commands at every physics step of the window after the effects on them, (n, H nsub, nu), or None."""
        acting = [(e, np.flatnonzero(e.active(values[id(e)]))) for e in self._on_command]
        if not any(len(rows) for _, rows in acting):
            return None
        used = self.history_steps(windows.control_dt)
        past = windows.history[:, windows.history.shape[1] - used :]
        signal = np.concatenate([past[window], windows.ctrl[window]], axis=1).repeat(nsub, axis=1)
        for e, rows in acting:
            if len(rows):
                signal[rows] = e.command(signal[rows], values[id(e)][rows], self.model.opt.timestep)
        return signal[:, used * nsub :]

    def _world(
        self,
        batch: mujoco.batch.Batch,
        fields: dict[str, Array],
        vector: NDArray[np.intp],
        values: dict[int, Array],
        n: int,
    ) -> tuple[World | None, list[tuple[Effect, NDArray[np.intp], Array]]]:
        """The view that effects act through, and which of them act on which rows."""
        acting = []
        for e in self._on_step:
            rows = np.flatnonzero(e.active(values[id(e)]))
            if len(rows):
                acting.append((e, rows, values[id(e)][rows]))
        for name in self._step_fields:
            own = fields[name][vector] if name in fields else get_field(self.model, name)
            batch.expand(name)[:n] = own
        if not acting:
            return None, []
        live = {f: batch.expand(f)[:n] for f in self._step_fields}
        world = World(
            self.model,
            *(batch.bind(f)[:n] for f in ("qpos", "qvel", "ctrl", "qfrc_applied")),
            fields=live,
        )
        self._own_fields = {f: v.copy() for f, v in live.items()}
        return world, acting

    def _act(self, world: World, acting: list[tuple[Effect, NDArray[np.intp], Array]]) -> None:
        for name, own in self._own_fields.items():
            world.fields[name][...] = own
        world.qfrc_applied[...] = 0.0
        for e, rows, v in acting:
            e.step(world, rows, v)


_FATAL = [
    int(w)
    for w in (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
]
"""MuJoCo resets a simulation that raises one of these and goes on with plausible numbers."""


def _split(space: ParameterSpace | None) -> tuple[ParameterSpace | None, list[Effect]]:
    """Separate a space into model fields and the effects whose parameters it holds."""
    if space is None:
        return None, []
    inside = effects_in(space)
    of_effects = [p for e in inside for p in e.parameters]
    keys = {(p.field, p.target) for p in of_effects}
    base = [p for p in space if (p.field, p.target) not in keys]
    if [*base, *of_effects] != list(space):
        raise BadEffect("parameters of effects must follow all others in a space, each effect's in its own order")
    return (ParameterSpace(base) if base else None), inside


def _column_slices(first: int, effects: Sequence[Effect]) -> list[slice]:
    slices = []
    for e in effects:
        slices.append(slice(first, first + len(e.parameters)))
        first += len(e.parameters)
    return slices
