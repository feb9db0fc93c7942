"""Which device Warp runs on, and what is said where it cannot."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Literal, get_args

import warp as wp

from nfpde.errors import BadInput

WarpDevice = Literal["cuda", "warp-cpu"]

CPU_BYTES = 1 << 30
"""Memory that buffers may take on Warp's CPU device, which is there for tests."""

SHARE = 0.8
"""Part of a GPU's free memory that may be taken; the rest is for kernels, and for others."""


@cache
def start_warp() -> None:
    """Initialise Warp, without its messages about devices and compiled modules."""
    wp.config.log_level = wp.LOG_ERROR
    wp.init()


def has_cuda() -> bool:
    """Whether Warp finds a CUDA device."""
    start_warp()
    return wp.is_cuda_available()


def open_device(name: WarpDevice) -> wp.Device:
    """Warp's device of that name.

    Raises:
        BadInput: no such name, no CUDA device and driver that Warp can use, or one without memory pools.
    """
    if name not in get_args(WarpDevice):
        raise BadInput(f"no device of MuJoCo Warp is called {name!r}; there are: {', '.join(get_args(WarpDevice))}")
    if name == "cuda" and not has_cuda():
        raise BadInput(
            "device 'cuda': Warp finds no CUDA device; check that nvidia-smi lists one and that its driver supports "
            f"CUDA {'.'.join(map(str, wp.get_cuda_toolkit_version() or ()))} or newer, or use device='cpu'"
        )
    start_warp()
    device = wp.get_device("cpu" if name == "warp-cpu" else "cuda:0")
    if device.is_cuda and not device.is_mempool_enabled:
        raise BadInput(
            "device 'cuda': MuJoCo Warp's steps need CUDA's memory pools, which this GPU or its driver does not "
            "support, or which WARP_ENABLE_MEMPOOLS_AT_INIT=0 has turned off; turn them on, or use device='cpu'"
        )
    return device


def free_bytes(device: wp.Device) -> int:
    """Memory [bytes] that simulations may take of what is free now."""
    # memory that was given back is free only when what was asked of the device is done
    wp.synchronize_device(device)
    return int(SHARE * device.free_memory) if device.is_cuda else CPU_BYTES


def ran_out(error: RuntimeError) -> bool:
    """Whether Warp's error says that memory could not be allocated; an illegal access to memory is none."""
    text = str(error).lower()
    return "failed to allocate" in text or "out of memory" in text


@contextmanager
def room_for(device: wp.Device, what: str) -> Iterator[None]:
    """Around allocations other than those of the worlds.

    Raises:
        BadInput: no memory for `what`.
    """
    try:
        yield
    except RuntimeError as error:
        if not ran_out(error):
            raise
        raise BadInput(f"{device}: no memory for {what} beside the worlds; pass a smaller nworld") from None


def out_of_memory(device: wp.Device, nworld: int, needed: int) -> BadInput:
    """The error to raise where the buffers of so many worlds, of so many bytes, could not be allocated.

    All that was to be given back must have been: worlds that fit are told by the memory that is free now.
    """
    memory, each = free_bytes(device), max(1, needed // nworld)
    fitting = max(1, min(memory // each, nworld // 2))
    return BadInput(
        f"{device}: no memory for {nworld} worlds of about {each / 1024:.0f} KiB each; {memory / 2**30:.1f} GiB may be "
        f"taken: pass nworld={fitting}, or shorter windows"
    )
