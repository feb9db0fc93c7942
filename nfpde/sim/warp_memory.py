"""How much memory a batch takes, from small ones: of each world, each row of parameters and each window."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import mujoco_warp as mjw
import warp as wp

from nfpde.sim.states import StateSpace
from nfpde.sim.warp_batch import Sizes, WarpBatch
from nfpde.sim.warp_effects import WarpEffects
from nfpde.sim.warp_model import WarpModel

FEW, MORE = 2, 6
"""Worlds, rows or windows of the batches that are compared."""


@dataclass(frozen=True)
class Footprint:
    """Memory [bytes] of a kind of batch.

    world: of each world, with what a step allocates and gives back
    row: of each row of parameters, with the constants that follow from it
    window: of each window of the recordings
    """

    world: int
    row: int
    window: int

    def of(self, sizes: Sizes) -> int:
        """Of a batch."""
        return sizes.nworld * self.world + sizes.nrow * self.row + sizes.nwindow * self.window

    def pairs(self, memory: int) -> int:
        """How many pairs fit, each with a row and a window of its own, at least 1."""
        return max(1, memory // max(1, self.world + self.row + self.window))

    def tile(self, memory: int, nvector: int, nwindow: int) -> tuple[int, int]:
        """How many of the vectors, and of the windows that each of these meets, fit at once, at least 1."""
        vectors = min(nvector, max(1, (memory - self.window) // max(1, self.world + self.row)))
        left = memory - vectors * self.row
        return vectors, min(nwindow, max(1, left // max(1, vectors * self.world + self.window)))


def footprint(model: WarpModel, effects: WarpEffects, space: StateSpace, kind: Sizes, device: wp.Device) -> Footprint:
    """That of batches that differ from `kind` in their numbers of worlds, rows and windows alone.

    Found from the arrays of small batches, and from what steps allocate while they run, which the solver and the
    Runge-Kutta integrator do.
    """

    def taken(nrow: int, nworld: int, nwindow: int) -> int:
        sizes = replace(kind, nrow=nrow, nworld=nworld, nwindow=nwindow)
        return WarpBatch(model, effects, space, sizes, device).nbytes()

    whole = taken(FEW, MORE, FEW)
    worlds = whole - taken(FEW, FEW, FEW)
    worlds += passing_bytes(model, kind, MORE, device) - passing_bytes(model, kind, FEW, device)
    others = taken(MORE, MORE, FEW) - whole, taken(FEW, MORE, MORE) - whole
    return Footprint(*(-(-more // (MORE - FEW)) for more in (worlds, *others)))


def passing_bytes(model: WarpModel, sizes: Sizes, nworld: int, device: wp.Device) -> int:
    """The most bytes that a physics step of so many worlds holds at once and gives back."""
    with wp.ScopedDevice(device):
        d = model.data(nworld, sizes.nconmax, sizes.njmax)
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
