"""A batch of worlds on a Warp device: buffers made once, a control step captured, run again and again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.kernels import loss as loss_kernels
from nfpde.kernels import past, rows, states, whitening
from nfpde.sim.past import speed_columns
from nfpde.sim.simulator import LOSS_LIMIT
from nfpde.sim.states import StateSpace
from nfpde.sim.warp_arrays import arrays_of, fill, first
from nfpde.sim.warp_constants import WarpConstants
from nfpde.sim.warp_effects import Staged, WarpEffects
from nfpde.sim.warp_graphs import Graphs
from nfpde.sim.warp_inbox import Inbox
from nfpde.sim.warp_model import WarpModel
from nfpde.sim.warp_overflow import flag_overflow

Array = NDArray[np.float64]

Output = Literal["states", "losses", "residuals"]


@dataclass(frozen=True)
class Sizes:
    """Everything that decides how large the buffers of a batch are.

    nrow: rows of the model's fields; world w reads row w % nrow
    nworld: worlds
    nwindow: windows of the recordings
    horizon: control steps in a window
    nhistory: commands from before its start
    npast: control steps before its start that effects are taken through
    nsub: physics steps in a control step
    output: what is kept of each step: the predicted states, their part of the loss, or their residuals
    all_pairs: whether every row meets every window; otherwise each world has a pair of its own
    wide: whether there are rows of all fields of `WIDE`, so that other simulators may run the batch
    nconmax: contacts in a world, on average
    njmax: constraints in a world
    """

    nrow: int
    nworld: int
    nwindow: int
    horizon: int
    nhistory: int
    npast: int
    nsub: int
    output: Output
    all_pairs: bool
    wide: bool
    nconmax: int
    njmax: int

    def single(self) -> Sizes:
        """That of a batch of one world, which tells what kind it is."""
        return replace(self, nrow=1, nworld=1, nwindow=1)


class WarpBatch:
    """Buffers, model and captured control step of one shape; see `nfpde.kernels` for the buffers' meaning.

    Args:
        model: fields that vary, and how the model is put on the device.
        effects: effects and their kernels.
        space: layout of a state.
        sizes: the shape.
        device: where it runs.
    """

    def __init__(
        self, model: WarpModel, effects: WarpEffects, space: StateSpace, sizes: Sizes, device: wp.Device
    ) -> None:
        self.sizes, self.device = sizes, device
        self._model, self._effects, self._space = model, effects, space
        z, nx, nu = sizes, space.nx, model.model.nu
        with wp.ScopedDevice(device):
            self._layout = model.wide if z.wide else model.narrow
            self.m, self._fields = model.put(self._layout, z.nrow, z.nworld)
            self._seen = {**model.views(self.m, effects.read_fields), **self._fields}
            self.d = model.data(z.nworld, z.nconmax, z.njmax)
            self.m.callback.passive = flag_overflow
            self._inbox = Inbox((z.nrow, self._layout.width))
            self._staged_rows = self._inbox.array
            self._staged = Staged(
                values=wp.zeros((z.nrow, max(1, effects.nvalue)), dtype=wp.float64),
                active=wp.zeros((z.nrow, max(1, len(effects.effects))), dtype=int),
                world_row=wp.zeros(z.nworld, dtype=int),
            )
            self._row = wp.zeros(z.nrow, dtype=int)
            self._world_window = wp.zeros(z.nworld, dtype=int)
            kept = z.output == "states"
            self._state = wp.zeros((z.nwindow, 1 if kept else z.horizon + 1, nx), dtype=wp.float64)
            self._past = wp.zeros((z.nwindow, z.npast, nx), dtype=wp.float64)
            self._speed = wp.array(speed_columns(model.model), dtype=int)
            self._ctrl = wp.zeros((z.nwindow, z.nhistory + z.horizon, nu), dtype=float)
            length = (z.nhistory + z.horizon) * z.nsub if effects.on_command else 0
            self._signal = wp.zeros((z.nworld, length, nu), dtype=float)
            self._predicted = wp.zeros((z.nworld, z.horizon if kept else 1, nx), dtype=float)
            channels = z.horizon * space.ndiff if z.output == "residuals" else 0
            self.residual = wp.zeros((z.nworld, channels), dtype=wp.float64)
            self.white = wp.zeros((z.nworld, channels), dtype=wp.float64)
            self._scale = wp.ones(channels or space.ndiff, dtype=wp.float64)
            self._known_scale = np.ones(channels or space.ndiff)
            starts = np.zeros(nx, np.int32)
            starts[[q for q, _ in space.quaternions]] = 1
            self._quaternion = wp.array(starts, dtype=int)
            self._alive = wp.zeros(z.nworld, dtype=int)
            self._loss = wp.zeros(z.nworld, dtype=wp.float64)
            self._step = wp.zeros(1, dtype=int)
            self._overflow = wp.zeros(1, dtype=int)
            self._static_geoms = wp.array(model.static_geoms, dtype=int)
            self._elements = effects.elements()
            self._memories = effects.memories(self._elements, z.nworld)
            # pairs of their own have a row per world, which the host writes; see WarpModel.stage
            self.derives = bool(model.derived) and z.all_pairs
            self._constants = WarpConstants(model.model, z.nrow) if self.derives else None
        self._control_dt = z.nsub * float(model.model.opt.timestep)
        self._paired: tuple[int, int] | None = None
        self._tables: dict[tuple[int, int], wp.array] = {}
        self._windows: Windows | None = None
        self._graphs = Graphs(device)

    def stage_parameters(self, fields: NDArray[np.float32], values: Array, active: NDArray[np.int32]) -> None:
        """Copy parameters of M <= nrow vectors onto the device, after they were given worlds, see `pair`.

        The model's fields follow from them while the windows are still on their way.
        """
        self._inbox.send(fields)
        if self._effects.effects:
            fill(self._staged.values, values)
            fill(self._staged.active, active)
        with wp.ScopedDevice(self.device):
            self._graphs.capture("fields", self._set_fields)
            with self._graphs.beside():
                self._graphs.launch("fields")

    def stage_windows(self, windows: Windows) -> None:
        """Copy n <= nwindow windows onto the device, unless they are those that it has."""
        if windows is self._windows:
            return
        z, nx = self.sizes, self._space.nx
        fill(self._state, windows.state[:, : self._state.shape[1], :nx])
        before = windows.history[:, windows.nhistory - z.nhistory :]
        fill(self._ctrl, np.concatenate([before, windows.ctrl], axis=1))
        fill(self._past, windows.past[:, windows.past.shape[1] - z.npast :, :nx])
        self._windows = windows

    def pair_all(self, nvector: int, nwindow: int) -> None:
        """Give world i * nrow + j the vector j and the window i."""
        z = self.sizes
        if self._paired == (nvector, nwindow):
            return
        self._paired = nvector, nwindow
        with wp.ScopedDevice(self.device):
            wp.launch(
                rows._pair_worlds,
                dim=z.nworld,
                inputs=[z.nrow, nvector, nwindow],
                outputs=[self._staged.world_row, self._world_window],
            )
            wp.copy(self._row, self._staged.world_row, count=z.nrow)

    def pair(self, vector: NDArray[np.intp], window: NDArray[np.intp]) -> None:
        """Give every world its own vector and window, (R,) each with R <= nworld = nrow."""
        self._paired = None
        for array, own in ((self._staged.world_row, vector), (self._world_window, window)):
            # worlds too many repeat the last pair
            array.assign(np.pad(own.astype(np.int32), (0, self.sizes.nworld - len(own)), mode="edge"))
        wp.copy(self._row, self._staged.world_row)

    def run(self, scale: Array) -> int:
        """Simulate all worlds through their windows; returns the bits of `mjw.OverflowType` that were set."""
        with wp.ScopedDevice(self.device):
            graphs = self._graphs
            if not np.array_equal(scale, self._known_scale):
                self._scale.assign(scale)
                self._known_scale = np.array(scale)
            graphs.join()
            graphs.capture("begin", self._begin)
            # the kernels of one physics step are those of all
            graphs.capture("step", partial(self._control_step, self.sizes.nsub), load=partial(self._control_step, 1))
            graphs.capture("end", self._end)
            graphs.launch("begin")
            for _ in range(self.sizes.horizon):
                graphs.launch("step")
            graphs.launch("end")
            return int(self._overflow.numpy()[0])

    def losses(self, nvector: int, nwindow: int) -> wp.array:
        """Losses of all pairs after `pair_all`, (nvector, nwindow), in the batch's own memory."""
        if (nvector, nwindow) not in self._tables:  # making a view takes a while
            table: Any = self._loss.reshape((-1, self.sizes.nrow))
            self._tables = {(nvector, nwindow): table[:nwindow, :nvector].transpose()}
        return self._tables[nvector, nwindow]

    def all_predictions(self, nvector: int, nwindow: int) -> NDArray[np.float32]:
        """Predicted states of all pairs after `pair_all`, (nvector, nwindow, H, nx)."""
        nrow = self.sizes.nrow
        table = self.predictions(nwindow * nrow).reshape(nwindow, nrow, *self._predicted.shape[1:])
        return table[:, :nvector].swapaxes(0, 1)

    def predictions(self, count: int) -> NDArray[np.float32]:
        """Predicted states of the first worlds, (count, H, nx)."""
        return np.asarray(first(self._predicted, count), np.float32)

    def residuals(self, count: int) -> Array:
        """Residuals of the first worlds, (count, C)."""
        return np.asarray(first(self.residual, count), np.float64)

    def serve(self, effects: WarpEffects) -> None:
        """Run with other effects from now on, which are alike and act on as many elements each; see `Family`."""
        if effects is not self._effects:
            self._effects = effects
            for place, arrays in self._elements.items():
                for array, numbers in zip(arrays, effects.numbers[place], strict=True):
                    fill(array, numbers)

    @property
    def freed(self) -> bool:
        """Whether its memory was given back."""
        return not vars(self)

    def poison(self) -> None:
        """Fill with NaN what a call sends and what it answers: what is not written cannot pass for an answer."""
        self._windows = None
        for array in (
            *(self._staged_rows, self._staged.values, self._state, self._past, self._ctrl),
            self._predicted,
            self._loss,
            self.residual,
            self.white,
            self.d.qpos,
            self.d.qvel,
            self.d.qacc,
            self.d.ctrl,
        ):
            array.fill_(np.nan)

    def nbytes(self) -> int:
        """Bytes of all its arrays; the solver's passing buffers come on top."""
        own = [v for v in vars(self).values() if isinstance(v, wp.array)]
        arrays = [*own, *self._fields.values(), *self._memories.values(), *arrays_of(self.d), *arrays_of(self._staged)]
        arrays += self._constants.arrays() if self._constants is not None else []
        return sum(a.capacity for a in arrays)

    def free(self) -> None:
        """Let go of all memory, whoever still holds the batch; it cannot run again."""
        if not self.freed:
            self._graphs.join()
            vars(self).clear()

    def _set_fields(self) -> None:
        for name, columns in self._layout.columns.items():
            if name not in self._model.step_fields and not (self.derives and name in (self._model.derived or ())):
                self._gather(name, columns, self._row)
        if self._constants is not None:
            self._constants.derive(self.m)

    def _begin(self) -> None:
        z, d = self.sizes, self.d
        self._model.place_static(self.m, d, self._static_geoms)
        self._effects.forget(self._memories)
        if self._effects.on_command:
            wp.launch(
                states._set_signal,
                dim=self._signal.shape,
                inputs=[self._ctrl, self._world_window, z.nsub],
                outputs=[self._signal],
            )
            self._effects.change_commands(self._elements, self._staged, self._signal)
        self._set_start()
        if z.npast:
            self._recall()
            self._set_start()

    def _set_start(self) -> None:
        d = self.d
        wp.launch(
            states._set_start,
            dim=self.sizes.nworld,
            inputs=[self._state, self._world_window, self._space.nq, self._space.nv],
            outputs=[
                *(d.qpos, d.qvel, d.qacc_warmstart, d.qfrc_applied, d.time, d.overflow),
                *(self._alive, self._loss, self._step),
            ],
        )
        self._unmeasure()

    def _unmeasure(self) -> None:
        """Go from the measured state to that of the simulation."""
        if not self._effects.on_sensor:
            return
        self._store()
        self._effects.measure(self._elements, self._staged, self._step, self._space.nq, self._predicted, back=True)
        wp.launch(
            states._set_state,
            dim=(self.sizes.nworld, self._space.nx),
            inputs=[self._predicted, self._space.nq],
            outputs=[self.d.qpos, self.d.qvel],
        )

    def _recall(self) -> None:
        """Take effects through the recorded motion before the start; what they do there comes to nothing."""
        z, d = self.sizes, self.d
        for k in range(z.npast * z.nsub):
            row, substep = divmod(k, z.nsub)
            wp.launch(
                past._follow_recording,
                dim=(z.nworld, self._space.nx),
                inputs=[
                    *(self._past, self._state, self._world_window, self._speed, self._space.nq),
                    *(z.npast, row, substep / z.nsub, self._control_dt),
                ],
                outputs=[d.qpos, d.qvel],
            )
            self._unmeasure()
            self._act(substep, z.npast - row, recalled=True)

    def _control_step(self, nsub: int) -> None:
        z = self.sizes
        for k in range(nsub):
            self._physics_step(k)
        self._store()
        self._effects.measure(self._elements, self._staged, self._step, self._space.nq, self._predicted)
        compared = [
            *(self._predicted, self._state, self._scale, self._quaternion),
            *(self._world_window, self._step),
        ]
        if z.output == "losses":
            wp.launch(loss_kernels._add_loss, dim=z.nworld, inputs=compared, outputs=[self._loss])
        elif z.output == "residuals":
            wp.launch(
                whitening._keep_residual,
                dim=z.nworld,
                inputs=[*compared, self._space.ndiff],
                outputs=[self.residual],
            )
        wp.launch(loss_kernels._count_step, dim=1, inputs=[], outputs=[self._step])

    def _end(self) -> None:
        nworld = self.sizes.nworld
        self._overflow.zero_()
        wp.launch(states._join_overflow, dim=nworld, inputs=[self.d.overflow], outputs=[self._overflow])
        wp.launch(loss_kernels._limit_loss, dim=nworld, inputs=[self._alive, LOSS_LIMIT], outputs=[self._loss])

    def _store(self) -> None:
        """Keep the state of the simulation as it is now."""
        wp.launch(
            loss_kernels._store_prediction,
            dim=(self.sizes.nworld, self._space.nx),
            inputs=[self.d.qpos, self.d.qvel, self._alive, self._step, self._space.nq],
            outputs=[self._predicted],
        )

    def _act(self, k: int, back: int = 0, *, recalled: bool = False) -> None:
        """Send the commands of a physics step and let the effects act.

        Args:
            k: of the control step's physics steps.
            back: control steps before the start of the window.
            recalled: whether only effects act that recall what was before the window.
        """
        z, d, nu = self.sizes, self.d, self._model.model.nu
        if self._effects.on_command:
            inputs = [self._signal, self._step, z.nhistory - back, z.nsub, k]
            wp.launch(states._send_signal, dim=(z.nworld, nu), inputs=inputs, outputs=[d.ctrl])
        elif k == 0:
            inputs = [self._ctrl, self._world_window, self._step, z.nhistory - back]
            wp.launch(states._set_ctrl, dim=(z.nworld, nu), inputs=inputs, outputs=[d.ctrl])
        if self._effects.on_step:
            for name in self._model.step_fields:
                self._gather(name, self._layout.columns[name], self._staged.world_row)
            d.qfrc_applied.zero_()
            d.xfrc_applied.zero_()
            self._effects.before_step(self._elements, self._memories, self._staged, d, self._seen, recalled=recalled)

    def _physics_step(self, k: int) -> None:
        z, d = self.sizes, self.d
        self._act(k)
        mjw.step(self.m, d)
        wp.launch(
            states._flag_divergence,
            dim=z.nworld,
            inputs=[self.m.qpos0, d.qacc, self._space.nq, self._space.nv],
            outputs=[d.qpos, d.qvel, d.qacc_warmstart, self._alive],
        )

    def _gather(self, name: str, columns: slice, row: wp.array) -> None:
        field = self._fields[name]
        wp.launch(rows._gather_field, dim=field.shape, inputs=[self._staged_rows, row, columns.start], outputs=[field])
