"""CPU seconds and memory of one solve in a fresh process, where nothing before it has raised the peak."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from nfpde.ot import emd


def footprint(points: Path) -> tuple[float, float]:
    """Solves once in a process of its own.

    Args:
        points: npz file with points x (n, d), y (m, d) and weights a (n,), b (m,), or without weights.

    Returns:
        CPU seconds, and by how many megabytes the peak of the process's memory grew (Linux only, else NaN).

    Raises:
        subprocess.CalledProcessError: The process failed; its message is on the standard error.
    """
    command = [sys.executable, "-m", "nfpde.bench.footprint", str(points)]
    answer = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    seconds, megabytes = json.loads(answer)
    return seconds, megabytes


def _status(name: str) -> float:
    """Megabytes of an entry of the process's status."""
    status = Path("/proc/self/status")
    if not status.exists():
        return float("nan")
    line = next(line for line in status.read_text().splitlines() if line.startswith(name))
    return int(line.split()[1]) / 1024


def main(points: Path) -> None:
    """Prints seconds and megabytes."""
    with np.load(points) as case:
        x, y, a, b = (case.get(name) for name in ("x", "y", "a", "b"))
    emd(x[:100], y[:100])  # what is loaded on first use
    peak = Path("/proc/self/clear_refs")
    if peak.exists():
        peak.write_text("5")  # the peak starts again at what is in use
    before, started = _status("VmHWM"), time.process_time()
    emd(x, y, a, b)
    seconds = time.process_time() - started
    print(json.dumps([seconds, _status("VmHWM") - before]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
