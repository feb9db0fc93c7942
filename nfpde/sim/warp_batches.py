"""The batches of a simulator: made for a shape, kept for its next call, given back where memory is wanted."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from weakref import WeakSet

import warp as wp

from nfpde.sim.states import StateSpace
from nfpde.sim.warp_batch import Sizes, WarpBatch
from nfpde.sim.warp_device import free_bytes, ran_out, room_for
from nfpde.sim.warp_effects import WarpEffects
from nfpde.sim.warp_family import FOOTPRINTS, Family, free_shared, shared_batch
from nfpde.sim.warp_memory import Footprint, footprint
from nfpde.sim.warp_model import WarpModel
from nfpde.sim.warp_whitening import WarpWhitening

SMALL = 1 << 12
"""Worlds up to which another shape, with buffers and a graph of its own, costs a GPU more than worlds beyond those that
were asked for: so few it steps in no more time than one."""

MOST_BATCHES = 3
"""Shapes whose buffers are kept: the losses of a fit, those of its last round, and predictions."""

ANY_WORLD = 1 << 20
"""More bytes than a world of any robot takes: a Humanoid's takes 28 KiB."""

SHARED_BYTES = 4 << 30
"""Memory of the small batches that simulators share, at most."""

_ALIVE: WeakSet[WarpBatches] = WeakSet()
"""Those of all simulators: what one does not use, another may need."""


class WarpBatches:
    """Makes and keeps batches.

    Args:
        model, effects, states, device: of the simulator.

    Attributes:
        kept: by shape, the one that ran last at the end.
        whitening: on the device beside them, given back with them.
        memory: bytes that all of them may take.
    """

    def __init__(self, model: WarpModel, effects: WarpEffects, states: StateSpace, device: wp.Device) -> None:
        self._model, self._effects, self._states, self._device = model, effects, states, device
        self._families = {wide: Family.of(model, effects, device, wide=wide) for wide in (False, True)}
        self.kept: dict[Sizes, WarpBatch] = {}
        self.whitening: WarpWhitening | None = None
        self.memory = free_bytes(device)
        _ALIVE.add(self)

    def get(self, sizes: Sizes) -> WarpBatch:
        """The batch of a shape, kept from an earlier call or new."""
        batch = self.kept.pop(sizes, None)
        if sizes.wide:
            room = min(SHARED_BYTES, self.memory - self.nbytes(*_alone(self.kept)))
            batch = shared_batch(self._families[True], sizes, self._effects, partial(self._make, sizes), room)
        elif batch is None:
            batch = self._make(sizes)
        self.kept[sizes] = batch
        return batch

    def most(self, kind: Sizes, wanted: int) -> int:
        """How many pairs run at once, each with a row and a window of its own: as many as fit, or as few as wanted.

        What a world takes is not measured where there is room for so many of any robot.
        """
        if kind.wide and wanted <= self.memory // ANY_WORLD:
            return wanted
        return self.footprint(kind).pairs(self.memory)

    def nbytes(self, *batches: Sizes) -> int:
        """Memory that batches of these shapes take together, with what a step allocates and gives back."""
        return sum(self.footprint(sizes).of(sizes) for sizes in batches)

    def footprint(self, sizes: Sizes) -> Footprint:
        """Memory of batches of that kind, measured once for each."""
        key = self._families[sizes.wide], sizes.single()
        if key not in FOOTPRINTS:
            measured = partial(footprint, self._model, self._effects, self._states, sizes.single(), self._device)
            try:
                FOOTPRINTS[key] = measured()
            except RuntimeError as error:
                if not ran_out(error):
                    raise
                self.free()
                self.others_freed()
                with room_for(self._device, "a few worlds, whose size is measured,"):
                    FOOTPRINTS[key] = measured()
        return FOOTPRINTS[key]

    def free(self) -> None:
        """Give all buffers back; the next call makes them anew."""
        while self.kept:
            self.kept.popitem()[1].free()

    def made_room(self, wanted: Sizes) -> bool:
        """Give back what is kept for calls of other shapes, or for other simulators' calls if there is none of these.

        Returns:
            Whether there was anything. What the shape's own batch took is given back as well, and is no more room.
        """
        own = any(sizes != wanted and not batch.freed for sizes, batch in self.kept.items())
        self.free()
        wp.synchronize_device(self._device)
        return own or self.others_freed()

    def others_freed(self) -> bool:
        """Have the device give back what is kept for other simulators' next calls; whether there was anything."""
        keeping = [b for b in _ALIVE if b is not self and b._device == self._device and b.kept]
        for batches in keeping:
            batches.free()
            batches.whitening = None
        shared = free_shared(self._device)
        wp.synchronize_device(self._device)
        return bool(keeping) or shared

    def _make(self, sizes: Sizes) -> WarpBatch:
        """A new batch, in place of the oldest ones where these are too many, or too large beside it."""
        kept = self.kept
        while kept and (len(kept) >= MOST_BATCHES or self.nbytes(*_alone([*kept, sizes])) > self.memory):
            oldest = next(iter(kept))
            batch = kept.pop(oldest)
            if not oldest.wide:
                batch.free()
        return WarpBatch(self._model, self._effects, self._states, sizes, self._device)


def _alone(shapes: Iterable[Sizes]) -> list[Sizes]:
    """Those of batches that no other simulator runs, whose memory is the simulator's own affair."""
    return [sizes for sizes in shapes if not sizes.wide]
