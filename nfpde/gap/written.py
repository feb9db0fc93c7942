"""How values with intervals, and the units of joints and channels, are written for people."""

from __future__ import annotations

import math

import mujoco

from nfpde.decimals import places_of, rounded
from nfpde.elements import element_names
from nfpde.gap.report import Fitted

_DIGITS = 4
"""Significant digits of a value whose interval says nothing of its precision."""


def with_interval(v: Fitted) -> tuple[str, str]:
    """A value and its interval without their unit, as precisely as the interval tells: to two digits of its half.

    A force whose interval reaches 2 N to either side is not known to a millinewton, and a shift of 1e-16 m is none.
    """
    half = (v.high - v.low) / 2
    if not (math.isfinite(half) and math.isfinite(v.value) and half > 0):
        numbers = [f"{x:.{_DIGITS}g}" if math.isfinite(x) else "–" for x in (v.value, v.low, v.high)]
    else:
        places = places_of(half, max(v.value, v.low, v.high, key=abs))
        numbers = [rounded(x, places) for x in (v.value, v.low, v.high)]
    return numbers[0], f"{numbers[1]} to {numbers[2]}"


def joint_unit(model: mujoco.MjModel, joint: str) -> str:
    """Unit of a joint's position, or of one of the axes of a free joint, such as `root.x`."""
    names = element_names(model, "joint")
    if joint in names:
        kind = int(model.jnt_type[names.index(joint)])
        return {int(mujoco.mjtJoint.mjJNT_SLIDE): "m", int(mujoco.mjtJoint.mjJNT_FREE): "m or rad"}.get(kind, "rad")
    return "m" if joint.rpartition(".")[2] in ("x", "y", "z") else "rad"


def channel_unit(model: mujoco.MjModel, channel: str) -> str:
    """Unit of a channel of the state's differences, such as `qvel knee` or `qpos root.rx`."""
    kind, _, joint = channel.partition(" ")
    return joint_unit(model, joint) + ("/s" if kind == "qvel" else "")
