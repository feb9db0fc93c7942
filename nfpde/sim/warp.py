"""The batched simulator: MuJoCo Warp, thousands of worlds at once on a GPU."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import product
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from nfpde.dataset import Dataset, Windows
from nfpde.effects import Effect
from nfpde.errors import BadInput, BadModel
from nfpde.parameters import ParameterSpace
from nfpde.sim.alike import ModelSource
from nfpde.sim.cpu import MujocoSimulator
from nfpde.sim.simulator import Array, Simulator, check_rows
from nfpde.sim.warp_arrays import fetched
from nfpde.sim.warp_batch import Output, Sizes, WarpBatch
from nfpde.sim.warp_batches import SMALL, WarpBatches
from nfpde.sim.warp_device import WarpDevice, open_device, out_of_memory, ran_out, room_for
from nfpde.sim.warp_effects import WarpEffects
from nfpde.sim.warp_model import WarpModel
from nfpde.sim.warp_overflow import COLLIDER, CONSTRAINTS, CONTACTS
from nfpde.sim.warp_sizes import buffer_sizes, cut, longest, power_of_two, roomy
from nfpde.sim.warp_whitening import WarpWhitening
from nfpde.sim.whitening import Whitening


@dataclass(frozen=True)
class Usage:
    """What a call took.

    nworld: worlds at once
    nbytes: memory predicted for them
    nconmax: contacts in a world that there was room for, on average
    njmax: constraints in a world that there was room for
    """

    nworld: int
    nbytes: int
    nconmax: int
    njmax: int


class WarpSimulator(Simulator):
    """MuJoCo Warp: single precision, every pair of parameters and window a world, all in one batch.

    Parameters go to the device, losses come back; states stay there. `reference` is the same simulator on the CPU,
    in double precision.

    Args:
        model: one or several in a list, see `MujocoSimulator`; the fields in which several differ have rows of their
            own, like those that parameters change.
        space: the parameters; see `MujocoSimulator`.
        effects: physics the model lacks; their parameters are appended to the space.
        device: `cuda`, or `warp-cpu` for tests: the same code, slower than `MujocoSimulator`.
        nworld: worlds at once, at most; 0 takes as many as fit into the memory that is free.
        check_influence: see `MujocoSimulator`, which does the check.

    Raises:
        BadModel: MuJoCo Warp lacks something the model uses.
        BadEffect: an effect without a kernel.
        BadParameter, BadInput: what cannot be used, and why.
    """

    def __init__(
        self,
        model: ModelSource | Sequence[ModelSource],
        space: ParameterSpace | None = None,
        effects: Sequence[Effect] = (),
        *,
        device: WarpDevice = "cuda",
        nworld: int = 0,
        check_influence: bool = True,
    ) -> None:
        self.device = open_device(device)
        if nworld < 0:
            raise BadInput(f"nworld must be positive, or 0 for as many as fit, got {nworld}")
        self.reference = MujocoSimulator(model, space, effects, check_influence=check_influence)
        self.models, self.model = self.reference.models, self.reference.model
        self.effects = self.reference.effects
        self.space, self.states = self.reference.space, self.reference.states
        self.rounding = float(np.finfo(np.float32).eps)
        self.memory_time, self.recall_time = self.reference.memory_time, self.reference.recall_time
        self.forgets = self.reference.forgets
        self.jumps = self.reference.jumps
        self.nworld = nworld
        writer = self.reference.writer
        with wp.ScopedDevice(self.device), room_for(self.device, "the model"):
            self._effects = WarpEffects(self.effects, writer.nbase, float(self.model.opt.timestep))
            self._model = WarpModel(self.model, self.space, writer, self._effects.step_fields)
            self._effects.look_up(self._model.model)
        self._batches = WarpBatches(self._model, self._effects, self.states, self.device)
        self._buffers: tuple[int, int] | None = None
        self._rounds = self.device.is_cuda

    def rollout(self, xi: Array, windows: Windows, vector: NDArray[np.intp], window: NDArray[np.intp]) -> Array:
        """See `Simulator.rollout`; more worlds than fit at once are simulated in chunks."""
        self._check_windows(windows)
        out = np.empty((len(vector), windows.horizon, self.states.nx))
        for part, _, batch in self._rows(xi, windows, vector, window, "states"):
            out[part] = batch.predictions(part.stop - part.start)
        return out

    def residuals(
        self, xi: Array, windows: Windows, vector: NDArray[np.intp], window: NDArray[np.intp], scale: ArrayLike
    ) -> Array:
        """See `Simulator.residuals`; differences are taken on the device, and states stay there."""
        unit = self._check_unit(windows, scale)
        out = np.empty((len(vector), len(unit)))
        for part, _, batch in self._rows(xi, windows, vector, window, "residuals", unit):
            out[part] = batch.residuals(part.stop - part.start)
        return out

    def costs(
        self,
        xi: Array,
        windows: Windows,
        vector: NDArray[np.intp],
        window: NDArray[np.intp],
        scale: ArrayLike,
        whitening: Whitening,
    ) -> Array:
        """See `Simulator.costs`; the whitening is sent once, and a number for every vector comes back."""
        unit = self._check_unit(windows, scale)
        check_rows(vector, windows, whitening)
        there = self._batches.whitening
        if there is None or there.whitening is not whitening:
            there = self._batches.whitening = None  # two of them need not fit
            with room_for(self.device, f"the whitening of {len(windows)} windows"):
                there = self._batches.whitening = WarpWhitening(whitening, self.device)
        out = np.zeros(len(xi))
        for part, own, batch in self._rows(xi, windows, vector, window, "residuals", unit):
            continues = part.start > 0 and bool(vector[part.start] == vector[part.start - 1])
            vectors, v = np.unique(vector[part], return_inverse=True)
            out[vectors] += there.costs(batch.residual, batch.white, v, own, continues=continues)
        return out

    def predict(self, xi: ArrayLike, windows: Windows) -> Array:
        """See `Simulator.predict`."""
        xi = self._check(xi, windows)
        self._check_windows(windows)
        m, n = len(xi), len(windows)
        if m * n <= SMALL:  # by pairs: batches that other simulators may run, of fewer shapes
            rows = self.rollout(xi, windows, *np.divmod(np.arange(m * n), n))
            return rows.reshape(m, n, windows.horizon, self.states.nx)
        out = np.empty((m, n, windows.horizon, self.states.nx))
        for vectors, chosen, batch in self._tiles(xi, windows, None):
            out[vectors, chosen] = batch.all_predictions(vectors.stop - vectors.start, chosen.stop - chosen.start)
        return out

    def losses(self, xi: ArrayLike, windows: Windows, scale: ArrayLike) -> Array:
        """See `Simulator.losses`; only parameters, windows and losses cross the bus."""
        return fetched(self.losses_on_device(xi, windows, scale))

    def losses_on_device(self, xi: ArrayLike, windows: Windows, scale: ArrayLike) -> wp.array:
        """See `Simulator.losses_on_device`: the batch's own memory where all pairs run at once."""
        xi = self._check(xi, windows)
        self._check_windows(windows)
        scale = np.asarray(scale, dtype=np.float64)
        if scale.shape != (self.states.ndiff,) or not (scale > 0).all():
            raise BadInput(f"scale must be {self.states.ndiff} positive numbers, one per channel, got {scale}")
        whole = len(xi), len(windows)
        if 0 in whole:
            return wp.array(shape=whole, dtype=wp.float64, device=self.device)
        out: Any = None
        for vectors, chosen, batch in self._tiles(xi, windows, scale):
            part = batch.losses(vectors.stop - vectors.start, chosen.stop - chosen.start)
            if part.shape == whole:
                return part
            if out is None:
                with room_for(self.device, f"{whole[0]} x {whole[1]} losses"):
                    out = wp.array(shape=whole, dtype=wp.float64, device=self.device)
            wp.copy(out[vectors, chosen], part)
        return out

    def prepare(self, dataset: Dataset) -> Dataset:
        """See `MujocoSimulator.prepare`."""
        return self.reference.prepare(dataset)

    def nominal(self) -> Array:
        """See `MujocoSimulator.nominal`."""
        return self.reference.nominal()

    def substeps(self, control_dt: float) -> int:
        """See `MujocoSimulator.substeps`."""
        return self.reference.substeps(control_dt)

    def identity(self) -> dict[str, Any]:
        """That of the reference, and that it ran in single precision."""
        return {**self.reference.identity(), "class": type(self).__name__, "mujoco_warp": version("mujoco_warp")}

    def release(self) -> None:
        """Give the memory of all buffers back; the next call makes them anew."""
        self._batches.free()
        self._batches.whitening = None

    def usage(self) -> Usage:
        """What the last call took.

        Raises:
            BadInput: nothing was simulated yet.
        """
        if not self._batches.kept:
            raise BadInput("nothing was simulated yet; call losses or predict first")
        sizes = next(reversed(self._batches.kept))
        return Usage(sizes.nworld, self._batches.nbytes(sizes), sizes.nconmax, sizes.njmax)

    def _rows(
        self,
        xi: Array,
        windows: Windows,
        vector: NDArray[np.intp],
        window: NDArray[np.intp],
        output: Output,
        scale: Array | None = None,
    ) -> Iterator[tuple[slice, NDArray[np.intp], WarpBatch]]:
        """Simulate pairs, as many at once as fit: which rows, their windows, and the batch that ran them in order."""
        self._check_windows(windows)
        self._count(len(vector), windows)
        done = 0
        while done < len(vector):
            count = len(vector) - done
            kind = replace(self._kind(windows, output, all_pairs=False), wide=output == "states" and count <= SMALL)
            most = self.nworld or self._batches.most(kind, self._rounded(count))
            parts = cut(slice(done, len(vector)), most)
            # few shapes, whose buffers are kept; one for all parts of a call, so that only one is in memory
            n = longest(parts) if len(parts) > 1 else min(most, self._rounded(count))
            sizes = replace(kind, nrow=n, nworld=n, nwindow=n)
            for part in parts:
                vectors, v = np.unique(vector[part], return_inverse=True)
                chosen, w = np.unique(window[part], return_inverse=True)
                some = windows if len(chosen) == len(windows) else windows[chosen]
                batch = self._run(sizes, xi[vectors], some, scale=scale, pairs=(v, w))
                if batch is None:
                    break
                yield part, window[part], batch
                done = part.stop

    def _rounded(self, count: int) -> int:
        return roomy(count) if self._rounds else power_of_two(count)

    def _tiles(self, xi: Array, windows: Windows, scale: Array | None) -> Iterator[tuple[slice, slice, WarpBatch]]:
        """Simulate all pairs, as many at once as fit: which vectors, which windows, and the batch that ran them."""
        output: Output = "states" if scale is None else "losses"
        self._count(len(xi) * len(windows), windows)
        left = [(slice(0, len(xi)), slice(0, len(windows)))]
        while left:
            kind = self._kind(windows, output)
            rows, columns = self._cut(kind, *left[0])
            # one shape for all of them, so that only one is in memory
            nrow, nwindow = longest(rows), longest(columns)
            sizes = replace(kind, nrow=nrow, nworld=nrow * nwindow, nwindow=nwindow)
            if self._rounds and sizes.nworld <= SMALL:
                nrow, nwindow = power_of_two(nrow), power_of_two(nwindow)
                rounded = replace(kind, nrow=nrow, nworld=nrow * nwindow, nwindow=nwindow)
                sizes = rounded if self._fits(rounded) else sizes
            tiles = list(product(rows, columns))
            left[:1] = tiles
            for vectors, chosen in tiles:
                part = windows if chosen == slice(0, len(windows)) else windows[np.arange(chosen.start, chosen.stop)]
                batch = self._run(sizes, xi[vectors], part, scale=scale)
                if batch is None:
                    break
                del left[0]
                yield vectors, chosen, batch

    def _run(
        self,
        sizes: Sizes,
        xi: Array,
        windows: Windows,
        *,
        scale: Array | None = None,
        pairs: tuple[NDArray[np.intp], NDArray[np.intp]] | None = None,
    ) -> WarpBatch | None:
        """Run a batch of the shape, with larger buffers for as long as they overflow.

        Returns:
            The batch; None where fewer worlds than these fit with larger buffers.
        """
        layout = self._model.wide if sizes.wide else self._model.narrow
        fields = self._model.stage(xi, layout, derive=self._model.derived is not None and sizes.all_pairs)
        values, active = self._effects.stage(xi)
        while True:
            nconmax, njmax = self._buffers or buffer_sizes(self.model, windows)
            wanted = replace(sizes, nconmax=nconmax, njmax=njmax)
            batch, overflow = None, 0
            try:
                batch = self._batches.get(wanted)
                if pairs is None:
                    batch.pair_all(len(xi), len(windows))
                else:
                    batch.pair(*pairs)
                batch.stage_parameters(fields, values, active)
                batch.stage_windows(windows)
                overflow = batch.run(np.ones(self.states.ndiff) if scale is None else scale)
            except RuntimeError as error:
                if not ran_out(error):
                    raise
                batch = None
            if batch is None:
                # here the error, and with it all that its frames hold, is gone
                if not self._batches.made_room(wanted):
                    raise out_of_memory(self.device, wanted.nworld, self._batches.nbytes(wanted))
                continue
            if overflow & COLLIDER:
                raise BadModel(
                    "MuJoCo Warp's buffers for collisions of meshes or height fields overflowed, and their size is "
                    "fixed; use simpler geoms (capsules, boxes), or device='cpu'"
                )
            if not overflow & (CONSTRAINTS | CONTACTS):
                return batch
            grown = (2 * nconmax if overflow & CONTACTS else nconmax, 2 * njmax if overflow & CONSTRAINTS else njmax)
            self._buffers = grown
            # freed, not dropped: whoever works through what it gave before still holds it
            self._batches.free()
            if sizes.nworld > 1 and not self._fits(replace(sizes, nconmax=grown[0], njmax=grown[1])):
                return None

    def _kind(self, windows: Windows, output: Output, *, all_pairs: bool = True) -> Sizes:
        steps = self.known_steps(windows), self.recalled_steps(windows)
        nsub = self.substeps(windows.control_dt)
        if self._buffers is None:
            self._buffers = buffer_sizes(self.model, windows)
        return Sizes(1, 1, 1, windows.horizon, *steps, nsub, output, all_pairs, False, *self._buffers)

    def _cut(self, kind: Sizes, vectors: slice, windows: slice) -> tuple[list[slice], list[slice]]:
        """Pieces of the vectors and of the windows: as many at once as were asked for, or as fit."""
        if self.nworld:
            rows = cut(vectors, self.nworld)
            return rows, cut(windows, max(1, self.nworld // longest(rows)))
        m, n = longest([vectors]), longest([windows])
        most = self._batches.footprint(kind).tile(self._batches.memory - 8 * m * n, m, n)  # beside their losses
        return cut(vectors, most[0]), cut(windows, most[1])

    def _fits(self, sizes: Sizes) -> bool:
        return sizes.nworld <= self.nworld if self.nworld else self._batches.nbytes(sizes) <= self._batches.memory

    def _check_windows(self, windows: Windows) -> None:
        if windows.ctrl.shape[2] != self.model.nu:
            raise BadInput(f"the windows have nu={windows.ctrl.shape[2]} commands, the model nu={self.model.nu}")
        self.substeps(windows.control_dt)

    def _count(self, rows: int, windows: Windows) -> None:
        self.simulated_steps += rows * windows.horizon * self.substeps(windows.control_dt)
