"""How large buffers must be: contacts and constraints from the data, bytes of a world from two small batches."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from nfpde.dataset import Windows
from nfpde.sim.quiet import quiet_mujoco
from nfpde.sim.states import StateSpace
from nfpde.sim.warp_batch import Sizes, WarpBatch
from nfpde.sim.warp_effects import WarpEffects
from nfpde.sim.warp_model import WarpModel

SAMPLE = 64
"""Measured states in which contacts and constraints are counted."""

HEADROOM = 2
"""Buffers hold so many times the most that was counted, as MuJoCo Warp's manual advises; too small ones are noticed."""

LEAST_CONTACTS, LEAST_CONSTRAINTS = 8, 32
"""Below these sizes nothing gets faster, and few shapes of kernels have to be compiled."""


def buffer_sizes(model: mujoco.MjModel, windows: Windows) -> tuple[int, int]:
    """Contacts (nconmax) and constraints (njmax) to have room for in each world."""
    data = mujoco.MjData(model)
    contacts = constraints = 0
    states = windows.state.reshape(-1, windows.state.shape[2])
    with quiet_mujoco():
        for row in np.linspace(0, len(states) - 1, min(SAMPLE, len(states))).astype(int):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = states[row, : model.nq], states[row, model.nq :]
            mujoco.mj_forward(model, data)
            contacts, constraints = max(contacts, data.ncon), max(constraints, data.nefc)
    return (
        _power_of_two(max(LEAST_CONTACTS, HEADROOM * contacts)),
        _power_of_two(max(LEAST_CONSTRAINTS, HEADROOM * constraints)),
    )


def bytes_per_world(model: WarpModel, effects: WarpEffects, space: StateSpace, sizes: Sizes, device: wp.Device) -> int:
    """Memory that one more world of its own row and window takes, the passing buffers of a step included.

    Found from the arrays of two and of six worlds; on a GPU from the memory pool as well, because the solver and the
    Runge-Kutta integrator allocate while they run.
    """
    one, two = (
        WarpBatch(model, effects, space, replace(sizes, nrow=n, nworld=n, nwindow=n), device).nbytes() for n in (2, 6)
    )
    own = (two - one) // 4
    return own + (_passing_bytes(model, sizes, device) if device.is_cuda else 0)


def _passing_bytes(model: WarpModel, sizes: Sizes, device: wp.Device, nworld: int = 1024) -> int:
    """Bytes a world that a physics step allocates and gives back, on a GPU."""
    with wp.ScopedDevice(device):
        m = model.nominal
        d = mjw.make_data(model.model, nworld=nworld, nconmax=sizes.nconmax, njmax=sizes.njmax)
        mjw.step(m, d)
        wp.synchronize_device(device)
        before = wp.get_mempool_used_mem_current(device)
        mjw.step(m, d)
        wp.synchronize_device(device)
        # the pool's high-water mark is that of the whole process: never less than what this step needed
        high = wp.get_mempool_used_mem_high(device)
    return max(0, high - before) // nworld


def _power_of_two(n: int) -> int:
    return 1 << (n - 1).bit_length()
