"""MuJoCo Warp stepping and nothing else: the mark that the losses of a batch are measured against."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.warp_sizes import buffer_sizes

Array = NDArray[np.float64]


def bare_stepping(
    simulator: WarpSimulator, nvector: int, windows: Windows, xi: Array | None = None
) -> Callable[[], None]:
    """What takes the physics steps of one control step in nvector x n worlds, captured once, from recorded states.

    The states are put back before each call, on the device, so that every call does the same work.

    Args:
        simulator: whose model, device and sizes of buffers it has.
        nvector: worlds that begin at each window.
        windows: n windows.
        xi: parameter vectors (nvector, D), with which these are the simulations of `losses`, in the same order; by
            default all worlds share the nominal model. How often the solver iterates depends on the model.
    """
    device, model = simulator.device, simulator.model
    nsub = simulator.substeps(windows.control_dt)
    nconmax, njmax = buffer_sizes(model, windows)
    nworld = nvector * len(windows)
    chosen = np.repeat(np.arange(len(windows)), nvector)
    with wp.ScopedDevice(device):
        m = mjw.put_model(model) if xi is None else _own_rows(simulator, xi, nworld)
        m.opt.warn_overflow = 0
        d = simulator._model.data(nworld, nconmax, njmax)
        qpos = wp.array(windows.start[chosen, : model.nq], dtype=float)
        qvel = wp.array(windows.start[chosen, model.nq :], dtype=float)
        d.ctrl.assign(windows.ctrl[chosen, 0].astype(np.float32))

        def steps() -> None:
            wp.copy(d.qpos, qpos)
            wp.copy(d.qvel, qvel)
            d.qacc_warmstart.zero_()
            for _ in range(nsub):
                mjw.step(m, d)

        steps()
        wp.synchronize_device(device)  # else what that gave back stays beside what the graph allocates
        with wp.ScopedCapture() as capture:
            steps()
    # the graph keeps none of the memory that it works on
    return partial(_replay, capture.graph, device, (m, d, qpos, qvel))


def _own_rows(simulator: WarpSimulator, xi: Array, nworld: int) -> mjw.Model:
    """The model as MuJoCo Warp steps it with a row of its own for each vector."""
    varied = simulator._model
    m, fields = varied.put(varied.narrow, len(xi), nworld)
    m.callback = copy.copy(m.callback)
    m.callback.passive = None  # a batch's, that looks for overflows
    rows = varied.stage(xi, varied.narrow, derive=False)
    for name, columns in varied.narrow.columns.items():
        fields[name].assign(np.ascontiguousarray(rows[:, columns]))
    return m


def _replay(graph: Any, device: wp.Device, kept: tuple[Any, ...]) -> None:
    with wp.ScopedDevice(device):
        wp.capture_launch(graph)
        wp.synchronize_device(device)


def used_bytes(simulator: WarpSimulator, before: int) -> int | None:
    """Memory that was taken on a GPU since so much of it was free; None on a CPU.

    What a step allocates and gives back is not seen in what is free afterwards: the memory pool's own count has it,
    and has not what graphs allocate, which is.
    """
    device = simulator.device
    if not device.is_cuda:
        return None
    wp.synchronize_device(device)
    return max(before - device.free_memory, int(wp.get_mempool_used_mem_high(device)))
