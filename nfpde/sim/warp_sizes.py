"""How large buffers must be: contacts and constraints from the data, bytes of a world from two small batches."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from typing import Any

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
        power_of_two(max(LEAST_CONTACTS, HEADROOM * contacts)),
        power_of_two(max(LEAST_CONSTRAINTS, HEADROOM * constraints)),
    )


def bytes_per_world(model: WarpModel, effects: WarpEffects, space: StateSpace, sizes: Sizes, device: wp.Device) -> int:
    """Memory that one more world of its own row and window takes, the passing buffers of a step included.

    Found from the arrays of two and of six worlds, and from what steps of both allocate while they run, which the
    solver and the Runge-Kutta integrator do.
    """
    few, more = 2, 6
    one, two = (
        WarpBatch(model, effects, space, replace(sizes, nrow=n, nworld=n, nwindow=n), device).nbytes()
        + passing_bytes(model, sizes, n, device)
        for n in (few, more)
    )
    return (two - one) // (more - few)


def passing_bytes(model: WarpModel, sizes: Sizes, nworld: int, device: wp.Device) -> int:
    """The most bytes that a physics step of so many worlds holds at once and gives back."""
    with wp.ScopedDevice(device):
        d = mjw.make_data(model.model, nworld=nworld, nconmax=sizes.nconmax, njmax=sizes.njmax)
        with counted(device) as counter:
            mjw.step(model.nominal, d)
    return counter.most


class Counter:
    """An allocator that passes everything on and knows how many bytes it gave out at once, at most."""

    def __init__(self, allocator: Any) -> None:
        self.deallocate_requires_context_guard = allocator.deallocate_requires_context_guard
        self.memory_kind = allocator.memory_kind
        self._allocator = allocator
        self._held = self.most = 0

    def allocate(self, size_in_bytes: int) -> int:
        """Memory of the other allocator."""
        pointer = self._allocator.allocate(size_in_bytes)
        self._held += size_in_bytes
        self.most = max(self.most, self._held)
        return pointer

    def deallocate(self, ptr: int, size_in_bytes: int) -> None:
        """Give it back there."""
        self._held -= size_in_bytes
        self._allocator.deallocate(ptr, size_in_bytes)


@contextmanager
def counted(device: wp.Device) -> Iterator[Counter]:
    """Count what is allocated on a device; the memory pool's own counts are of the process's whole life."""
    before: Any = wp.get_device_allocator(device)
    counter: Any = Counter(before)
    if device.is_cpu:  # Warp lets nobody set an allocator there
        device.default_allocator = counter
    else:
        wp.set_device_allocator(device, counter)
    try:
        yield counter
    finally:
        if device.is_cpu:
            device.default_allocator = before
        else:
            wp.set_device_allocator(device, None if before is device.current_allocator else before)


def power_of_two(n: int) -> int:
    """The least power of two that is no smaller."""
    return 1 << (n - 1).bit_length()


def cut(whole: slice, most: int) -> list[slice]:
    """Cut a range into near-equal pieces of at most `most`."""
    pieces = -(-(whole.stop - whole.start) // most)
    if pieces == 1:
        return [whole]
    ends = np.linspace(whole.start, whole.stop, pieces + 1).round().astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def longest(pieces: list[slice]) -> int:
    """Length of the longest of several ranges, at least 1."""
    return max((p.stop - p.start for p in pieces), default=1)
