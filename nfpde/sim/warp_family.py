"""What simulators of one family share: the buffers and graphs of small calls, and how much memory a world takes.

A diagnosis makes a simulator for every set of causes it tries, hundreds of them, and asks each a few times for a few
hundred simulations. Most differ in where their effects act alone: to these a batch is the same, with other numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from nfpde.sim.warp_batch import Sizes, WarpBatch
from nfpde.sim.warp_effects import WarpEffects
from nfpde.sim.warp_memory import Footprint
from nfpde.sim.warp_model import WarpModel

MOST_SHARED = 64
"""Batches that a device keeps for whoever comes next, at most."""


@dataclass(frozen=True)
class Family:
    """All that captured work depends on beside its shape: simulators of which this is equal run each other's batches.

    device: where they run
    model: hash of the nominal model, with all switches that some parameter vector switches on
    fields: that have rows, in the order of their columns
    step_fields: that effects change before every physics step
    derived: fields that the device derives, if it does and the batch has rows of those alone that vary
    flags: switches of MuJoCo Warp's own that some parameter vector needs
    effects: see `WarpEffects.alike`
    """

    device: str
    model: str
    fields: tuple[str, ...]
    step_fields: tuple[str, ...]
    derived: frozenset[str] | None
    flags: tuple[tuple[str, bool], ...]
    effects: tuple[object, ...]

    @classmethod
    def of(cls, model: WarpModel, effects: WarpEffects, device: wp.Device, *, wide: bool) -> Family:
        """That of a simulator's model and effects; `wide` as in `Sizes`."""
        flags, step_fields = tuple(sorted(model.flags.items())), tuple(model.step_fields)
        fields, derived = (model.wide.fields, None) if wide else (model.narrow.fields, model.derived)
        return cls(device.alias, model.hash, fields, step_fields, derived, flags, effects.alike())


Shared = dict[tuple[Family, Sizes], tuple[WarpBatch, int]]

_SHARED: dict[str, Shared] = {}
"""By device, the batches that were used last of all, the latest at the end, and their bytes."""

FOOTPRINTS: dict[tuple[Family, Sizes], Footprint] = {}
"""Of every kind of batch that was measured in this process: some numbers each."""


def shared_batch(
    family: Family, sizes: Sizes, effects: WarpEffects, make: Callable[[], WarpBatch], room: int
) -> WarpBatch:
    """A batch of the shape that runs with these effects: one that is kept, or a new one, which is kept.

    Args:
        family: of the simulator.
        sizes: the shape.
        effects: what the batch is to run with.
        make: makes one.
        room: bytes that may be kept beside it.
    """
    kept = _SHARED.setdefault(family.device, {})
    key = family, sizes
    batch, nbytes = kept.pop(key, (None, 0))
    if batch is None or batch.freed:
        while kept and (len(kept) >= MOST_SHARED or sum(taken for _, taken in kept.values()) > room):
            kept.pop(next(iter(kept)))[0].free()
        batch = make()
        nbytes = batch.nbytes()
    batch.serve(effects)
    kept[key] = batch, nbytes
    return batch


def free_shared(device: wp.Device) -> bool:
    """Give back all that a device keeps for whoever comes next; whether there was anything."""
    kept = [batch for batch, _ in _SHARED.pop(device.alias, {}).values() if not batch.freed]
    for batch in kept:
        batch.free()
    return bool(kept)
