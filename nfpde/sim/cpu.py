"""The reference simulator: plain MuJoCo in double precision on all CPU cores."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from typing import Any

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset, Windows
from nfpde.dataset.timing import same_step
from nfpde.dataset.windows import check_count
from nfpde.effects import Effect
from nfpde.errors import BadInput, BadModel, BadParameter
from nfpde.parameters import ParameterSpace
from nfpde.sim.acting import BoundEffects, checked_effects, split_space
from nfpde.sim.alike import ModelSource, load_models, refuse_unlike_effects
from nfpde.sim.cores import usable_cores
from nfpde.sim.fields import get_field
from nfpde.sim.limits import refuse_taken
from nfpde.sim.matching import match_dataset
from nfpde.sim.model import model_hash
from nfpde.sim.past import recorded_motion
from nfpde.sim.probe import refuse_inert
from nfpde.sim.quiet import quiet_mujoco
from nfpde.sim.simulator import Array, Simulator, rows_at_once
from nfpde.sim.states import StateSpace
from nfpde.sim.writer import ModelWriter

_AT_HAND = 4
"""Simulators that keep their batch, those that were used last: a quadruped's holds some ten MB, and a diagnosis has
hundreds of simulators."""

_lately: list[weakref.ref[MujocoSimulator]] = []
"""These, the last one last."""


class MujocoSimulator(Simulator):
    """MuJoCo on the CPU (`mujoco.batch`): every row of a call is one simulation, all of them side by side.

    Args:
        model: path of an MJCF or URDF file, or a compiled mjModel; see `load_model` for what is changed in it. Or
            several in a list, of one size: same tree, types, names of joints and actuators, command ranges and
            options that are no real numbers; masses, places, lengths, gains and other real numbers may differ. The
            parameter `Parameter("model", low=0, high=<how many>)` then says which of them a simulation is of: model k
            holds the values from k up to k + 1. Fit it by softmax: the share of the distribution between k and k + 1 is
            the probability of model k.
        space: the parameters. Parameters of effects (`coulomb_friction.torque`) may be among them, as they are in
            the space of a saved distribution; None where only effects are unknown.
        effects: physics the model lacks; their parameters are appended to the space.
        nthread: threads; 0 takes all cores this process may use.
        check_influence: refuse parameters that change nothing, found by simulating; switch it off for parameters
            that only matter in states which random motion does not reach.

    Raises:
        BadModel, BadParameter, BadEffect: what cannot be used, and why.
        BadInput: nthread is no whole number, or negative.
    """

    def __init__(
        self,
        model: ModelSource | Sequence[ModelSource],
        space: ParameterSpace | None = None,
        effects: Sequence[Effect] = (),
        *,
        nthread: int = 0,
        check_influence: bool = True,
    ) -> None:
        effects = checked_effects(effects)
        check_count(nthread, "nthread", 0)
        self.models = load_models(model)
        self.model = self.models[0]
        base, inside = split_space(space)
        if base is None and not inside and not effects:
            raise BadParameter("give a parameter space or at least one effect; there is nothing to estimate")
        self.effects = [e.bind(self.model) for e in [*inside, *effects]]
        refuse_unlike_effects(self.effects, self.models)
        refuse_taken(self.model, base, self.effects)
        self.space = ParameterSpace([*(base or ()), *(p for e in self.effects for p in e.parameters)])
        self.states = StateSpace.of_model(self.model)
        self.writer = ModelWriter(self.models, base, self.effects)
        column = self.writer.model_column
        self.jumps = () if column is None else (column,)
        self.nthread = nthread or usable_cores()
        self._bound = BoundEffects(self.model, self.effects, self.writer.nbase)
        self.memory_time, self.recall_time = self._bound.memory_time, self._bound.recall_time
        self.forgets = all(e.forgets for e in self.effects)
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
        steps = windows.horizon + (windows.nhistory if self._bound.on_command else 0)
        size = rows_at_once(windows.horizon * self.states.nx + steps * self.model.nu * nsub)
        with quiet_mujoco(), np.errstate(over="ignore", invalid="ignore"):
            for start in range(0, len(vector), size):
                part = slice(start, start + size)
                out[part] = self._simulate(xi[vector[part]], fields, vector[part], windows, window[part], nsub)
        self.simulated_steps += len(vector) * windows.horizon * nsub
        return out

    def release(self) -> None:
        """See `Simulator.release`."""
        self._batch = None

    def prepare(self, dataset: Dataset) -> Dataset:
        """The data set with its columns in the model's order; see `Simulator.prepare`."""
        return match_dataset(self.model, self.states, dataset)

    def nominal(self) -> Array:
        """The model's own parameters, and neutral ones of the effects, (D,); NaN where elements or models differ."""
        neutral = [q.neutral for e in self.effects for q in e.quantities]
        return np.concatenate([self.writer.nominal_values(), neutral])

    def identity(self) -> dict[str, Any]:
        """The model's fingerprint, or those of several, and MuJoCo's version; the effects are in the space."""
        prints = [model_hash(m) for m in self.models]
        return {**super().identity(), "model": prints if prints[1:] else prints[0], "mujoco": mujoco.__version__}

    def substeps(self, control_dt: float) -> int:
        """Physics steps in a control step of control_dt [s].

        A clock may be off by the 0.1 % that `check_against_model` lets pass: a control step is simulated as that many
        whole physics steps, and what the clock is off by is for the effect `time_scale` to say.

        Raises:
            BadInput: it is no multiple of the model's timestep.
        """
        timestep = self.model.opt.timestep
        nsub = round(control_dt / timestep)
        if not same_step(nsub * timestep, control_dt):
            raise BadInput(
                f"the control step {control_dt:g} s is no multiple of the model's timestep {timestep:g} s; set the "
                f"timestep to {control_dt / max(1, nsub):g} s or resample the data"
            )
        return nsub

    def _simulate(
        self,
        xi: Array,
        fields: dict[str, Array],
        vector: NDArray[np.intp],
        windows: Windows,
        window: NDArray[np.intp],
        nsub: int,
    ) -> Array:
        """Simulate rows side by side: xi (R, D), the model fields of all vectors, and which vector each row has."""
        n, horizon, nq = len(xi), windows.horizon, self.states.nq
        batch = self._prepared_batch(n)
        for name, values in fields.items():
            np.take(values, vector, axis=0, out=batch.expand(name)[:n], mode="clip")  # "clip" writes without a copy
        for name in set(self._bound.step_fields) - fields.keys():
            batch.expand(name)[:n] = get_field(self.model, name)
        effects = self._bound.on_rows(xi)
        start = effects.to_simulated(windows.state[window, 0])
        qpos, qvel, ctrl = (batch.bind(name)[:n] for name in ("qpos", "qvel", "ctrl"))
        before_step = effects.before_steps(batch, n)
        past = 0 if before_step is None else self.recalled_steps(windows, before_step.recall_time)
        history = self.known_steps(windows)
        signal = effects.commands(windows, window, history, nsub, past)
        if past and before_step is not None:
            measured = windows.past[window, windows.past.shape[1] - past :]
            known: NDArray[np.bool_] = np.asarray(np.isfinite(measured).all(2))
            rows = np.stack([*(effects.to_simulated(measured[:, i]) for i in range(past)), start], axis=1)
            sent = signal
            if sent is None:
                sent = windows.history[window, windows.nhistory - past :].repeat(nsub, axis=1)
            for k, (q, v) in enumerate(recorded_motion(self.model, rows, nsub)):
                qpos[:], qvel[:], ctrl[:] = q, v, sent[:, k]
                before_step.recall(known[:, k // nsub])
        signal = None if signal is None else signal[:, past * nsub :]
        qpos[:], qvel[:] = start[:, :nq], start[:, nq:]
        single = nsub if signal is None and before_step is None else 1
        out = np.empty((n, horizon, self.states.nx))
        alive = np.arange(n)
        for h in range(horizon):
            ctrl[:] = windows.ctrl[window, h]
            for k in range(0, nsub, single):
                if signal is not None:
                    ctrl[:] = signal[:, h * nsub + k]
                if before_step is not None:
                    before_step()
                _step(batch, alive, single)
            # MuJoCo resets a simulation that blew up and goes on; every warning that it counts makes its numbers wrong
            broken = batch.warning[:n, :, 1].any(1)
            out[:, h, :nq], out[:, h, nq:] = qpos, qvel
            if broken.any():
                out[broken, h:] = np.nan
                alive = np.flatnonzero(~broken)
        out = effects.to_measured(out)
        out[np.logical_or.accumulate(~np.isfinite(out).all(2), axis=1)] = np.nan
        return out

    def _prepared_batch(self, n: int) -> mujoco.batch.Batch:
        """The batch, with its first n simulations at rest at time 0 and without a warm start."""
        batch = self._batch
        if batch is None or batch.nsim < n:
            size = 1 << (n - 1).bit_length()
            self._batch = batch = mujoco.batch.Batch(self.model, size, self.nthread)
            self._rest = batch.state[0].copy()
        self._keep_at_hand()
        batch.state[:n] = self._rest
        batch.warning[:n] = 0
        return batch

    def _keep_at_hand(self) -> None:
        """Count as used last; whoever was not used for longest gives its batch back."""
        others = [ref for ref in _lately if ref() not in (None, self)]
        for ref in others[: 1 - _AT_HAND]:
            simulator = ref()
            if simulator is not None:
                simulator.release()
        _lately[:] = [*others[1 - _AT_HAND :], weakref.ref(self)]


def _step(batch: mujoco.batch.Batch, ids: NDArray[np.intp], nstep: int) -> None:
    try:
        batch.step(ids, nstep=nstep)
    except mujoco.batch.SimulationError as error:
        raise BadModel(f"MuJoCo cannot simulate this model: {error}") from None
