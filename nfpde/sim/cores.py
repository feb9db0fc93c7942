"""How many cores this process may use."""

import os


def usable_cores() -> int:
    """Those that the process is bound to, or all where the system binds none (macOS, Windows)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
