"""Work on a Warp device that is captured once and launched as one graph from then on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import warp as wp


class Graphs:
    """Pieces of work by name, and a stream beside the current one for work that need not be waited for at once.

    Args:
        device: where they run; the current one wherever something is captured.
    """

    def __init__(self, device: wp.Device) -> None:
        self._device = device
        self._graphs: dict[str, Any] = {}
        self._beside = wp.Stream(device) if device.is_cuda else None

    def capture(self, name: str, work: Callable[[], None], load: Callable[[], None] | None = None) -> None:
        """Capture a piece of work, unless there is one of that name.

        Args:
            name: what to launch it by.
            work: launches kernels and copies on the device; the same ones every time, on the same arrays.
            load: launches the same kernels at least once, for less; by default the work itself.
        """
        if name in self._graphs:
            return
        # kernels are loaded by their first launch, which a capture cannot hold
        (load or work)()
        # what that allocated and gave back would stay beside what the graph allocates for itself
        wp.synchronize_device(self._device)
        with wp.ScopedCapture() as capture:
            work()
        self._graphs[name] = capture.graph

    def launch(self, name: str) -> None:
        """Launch captured work on the current stream."""
        wp.capture_launch(self._graphs[name])

    @contextmanager
    def beside(self) -> Iterator[None]:
        """Within it, launch after all that was asked for so far, and beside all that comes, until `join`."""
        if self._beside is None:
            yield
            return
        with wp.ScopedStream(self._beside):
            yield

    def join(self) -> None:
        """Have what comes wait for what was launched beside it."""
        if self._beside is not None:
            wp.get_stream(self._device).wait_stream(self._beside)
