"""How large buffers must be: contacts and constraints from the data; and how a range is cut."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np

from nfpde.dataset import Windows
from nfpde.sim.quiet import quiet_mujoco

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


def power_of_two(n: int) -> int:
    """The least power of two that is no smaller."""
    return 1 << (n - 1).bit_length()


def roomy(n: int) -> int:
    """The least of 64, 256, 1024 and greater powers of two that is no smaller: few numbers of worlds for a GPU."""
    return next((size for size in (64, 256, 1024) if n <= size), power_of_two(n))


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
