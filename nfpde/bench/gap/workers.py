"""Processes that work at several cases at a time: each on cores of its own, none outlives the run."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from nfpde.bench.gap.cases import Case

_GRACE = 5.0
"""Seconds that a worker has to stop a diagnosis."""


def workers(jobs: int) -> ProcessPoolExecutor:
    """Worker processes, started afresh; see `begin`."""
    context = multiprocessing.get_context("spawn")
    shares = context.Queue()
    for share in shared_cores(jobs):
        shares.put(share)
    return ProcessPoolExecutor(jobs, mp_context=context, initializer=begin, initargs=(shares,))


def stop(pool: ProcessPoolExecutor) -> None:
    """Stop what its workers do, and what waits: they would work through all of it before an interrupt is heard."""
    pool.shutdown(wait=False, cancel_futures=True)
    for worker in multiprocessing.active_children():
        worker.terminate()


def unless_ended(task: Callable[[Case], int], case: Case) -> int:
    """Run a task; a worker that was told to end meanwhile does: the pool would take that for the task's own failure."""
    try:
        return task(case)
    except SystemExit:
        os._exit(1)


def shared_cores(jobs: int) -> list[set[int]]:
    """Cores for each of so many processes, of those that this process may use; none where the system has no such thing.

    A diagnosis takes all cores that it may use. Two that share theirs wait for each other at every step.
    """
    if not hasattr(os, "sched_setaffinity"):
        return []
    cores = sorted(os.sched_getaffinity(0))
    return [set(cores[job::jobs]) or {cores[job % len(cores)]} for job in range(jobs)]


def begin(shares: Any) -> None:
    """Begin as a worker: on a share of the cores from a queue, and to end with the parent."""
    try:
        share: set[int] = shares.get(timeout=1.0)
    except queue.Empty:  # a worker that takes the place of one that died, or a system without shares
        share = set()
    if share:
        os.sched_setaffinity(0, share)
    end_with_parent()


def end_with_parent() -> None:
    """Have a worker stop what it does when the process that started it is gone, even if that was killed.

    A diagnosis that went on would write its answer beside those of the run that goes on in its place.
    """
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(_GRACE)
            os._exit(1)

    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    threading.Thread(target=watch, daemon=True).start()
