"""MuJoCo Warp stepping and nothing else: the mark that the losses of a batch are measured against."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco_warp as mjw
import numpy as np
import warp as wp

from nfpde.dataset import Windows
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.warp_sizes import buffer_sizes


def bare_stepping(simulator: WarpSimulator, windows: Windows, nworld: int) -> Callable[[], None]:
    """What takes the physics steps of one control step in `nworld` worlds, captured once, from recorded states.

    One model for all worlds, buffers of the simulator's sizes. The states are put back before each call, on the
    device, so that every call does the same work.
    """
    device, model = simulator.device, simulator.model
    nsub = simulator.substeps(windows.control_dt)
    nconmax, njmax = buffer_sizes(model, windows)
    chosen = np.arange(nworld) % len(windows)
    with wp.ScopedDevice(device):
        m = mjw.put_model(model)
        m.opt.warn_overflow = 0
        d = mjw.make_data(model, nworld=nworld, nconmax=nconmax, njmax=njmax)
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
        with wp.ScopedCapture() as capture:
            steps()
        graph: Any = capture.graph

    def run() -> None:
        with wp.ScopedDevice(device):
            wp.capture_launch(graph)
            wp.synchronize_device(device)

    return run


def used_bytes(simulator: WarpSimulator) -> int | None:
    """Memory that Warp has taken on a GPU and not given back to the system; None on a CPU."""
    if not simulator.device.is_cuda:
        return None
    wp.synchronize_device(simulator.device)
    return int(wp.get_mempool_used_mem_high(simulator.device))
