"""Memory that was freed goes back to the operating system."""

import ctypes
import sys
from pathlib import Path

import numpy as np
import pytest

from nfpde.gap import heap


def resident() -> int:
    """Memory of this process that is in use or kept [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks Linux")
def test_what_lies_free_below_something_in_use_is_given_back():
    """Blocks of 64 KiB, every thousandth of which lives on: of 400 MiB three quarters at least are given back."""
    if not hasattr(ctypes.CDLL(None), "malloc_trim"):
        pytest.skip("this C library is not glibc")
    heap.give_back()
    before = resident()
    blocks = [np.ones(1 << 13) for _ in range(6400)]
    full = resident() - before
    living = blocks[::1000]
    del blocks
    heap.give_back()
    assert full > 350e6  # what lay free before took some of it
    assert resident() - before < 0.25 * full
    assert all((block == 1).all() for block in living)


def test_where_there_is_another_c_library_nothing_is_done(monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    heap._trim.cache_clear()
    heap.give_back()
    assert heap._trim() is None
    heap._trim.cache_clear()
