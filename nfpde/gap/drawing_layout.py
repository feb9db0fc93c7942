"""Where everything of the robot's picture goes: joints that share a place, their discs, labels that do not overlap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.drawing import Skeleton

Array = NDArray[np.float64]

WIDTH = 680.0
TEXT = 14.5
"""Height of the letters."""

_MARGIN = 26.0
_LINE = 18.0
_GAP = 24.0
"""Between the labels and the drawing."""

_LONGEST = 18
_MOST = 26
"""Labels drawn at most; the other joints keep their discs and the text that shows under the pointer."""


@dataclass(frozen=True)
class Label:
    """A joint's name and share beside the drawing; `x`, `y` is the near end of the text."""

    x: float
    y: float
    left: bool
    text: str
    full: str
    share: float


@dataclass(frozen=True)
class Disc:
    """Joints that lie at one place: the share of all of them, and the labels that name them."""

    x: float
    y: float
    radius: float
    share: float
    joints: tuple[str, ...]
    labels: tuple[Label, ...] = ()


@dataclass(frozen=True, eq=False)
class Layout:
    """The picture in pixels, y downward; outlines (points, 2) with `fixed` as in the skeleton."""

    width: float
    height: float
    outlines: Sequence[Array]
    fixed: Sequence[bool]
    discs: Sequence[Disc]
    ground: float | None


def lay_out(skeleton: Skeleton, share: Mapping[str, float]) -> Layout:
    """Scale a skeleton into a picture and label its joints.

    Args:
        skeleton: of `project`.
        share: the joints' shares of the gap; empty to leave the joints without colour and number.
    """
    points = np.vstack([*skeleton.outlines, skeleton.anchors, np.zeros((0, 2))])
    if not len(points):
        points = np.zeros((1, 2))
    low, high = points.min(0), points.max(0)
    if skeleton.ground is not None:
        low[1] = min(low[1], skeleton.ground)
    size = np.maximum(high - low, 1e-6)
    longest = max([min(len(n), _LONGEST) for n in skeleton.joints] or [0])
    column = 0.7 * TEXT * (longest + (4 if share else 0)) + _GAP
    room = WIDTH - 2 * column - _MARGIN
    lines = min(len(skeleton.joints), _MOST)
    height = max(300.0, min(480.0, room * float(size[1] / size[0]) + 2 * _MARGIN), _LINE * (lines / 2 + 4) + 20)
    scale = min(room / float(size[0]), (height - 2 * _MARGIN) / float(size[1]))
    middle = 0.5 * (low + high)

    def pixels(p: Array) -> Array:
        return np.array([WIDTH / 2, height / 2]) + scale * (p - middle) * [1.0, -1.0]

    ground = None if skeleton.ground is None else float(pixels(np.array([0.0, skeleton.ground]))[1])
    discs = _discs(skeleton.joints, pixels(skeleton.anchors), share)
    outlines = [pixels(p) for p in skeleton.outlines]
    return Layout(WIDTH, height, outlines, list(skeleton.fixed), _labelled(discs, share, height, column), ground)


def _discs(joints: Sequence[str], anchors: Array, share: Mapping[str, float]) -> list[Disc]:
    """One disc for each place where joints lie."""
    places: list[tuple[Array, list[str]]] = []
    for name, at in zip(joints, anchors, strict=True):
        near = [names for spot, names in places if np.linalg.norm(spot - at) < 7.0]
        if near:
            near[0].append(name)
        else:
            places.append((at, [name]))
    total = [sum(max(share.get(n, 0.0), 0.0) for n in names) for _, names in places]
    top = max([*total, 1e-12])
    return [
        Disc(float(at[0]), float(at[1]), 5.0 + 12.0 * float(np.sqrt(part / top)), part, tuple(names))
        for (at, names), part in zip(places, total, strict=True)
    ]


def _labelled(discs: list[Disc], share: Mapping[str, float], height: float, column: float) -> list[Disc]:
    """Give every disc its labels, in a column on either side."""
    names = [n for d in discs for n in d.joints]
    shown = set(sorted(names, key=lambda n: -share.get(n, 0.0))[:_MOST])
    count = {d: sum(n in shown for n in d.joints) for d in discs}
    across = sorted(discs, key=lambda d: d.x)
    left = [d for d in across if d.x < WIDTH / 2 - 1]
    right = [d for d in across if d.x >= WIDTH / 2 - 1]
    for here, there, end in ((left, right, -1), (right, left, 0)):
        while here and sum(count[d] for d in here) - count[here[end]] > sum(count[d] for d in there) + 2:
            there.append(here.pop(end))
    done = []
    for side, is_left in ((left, True), (right, False)):
        side.sort(key=lambda d: (d.y, d.x))
        x = column - _GAP if is_left else WIDTH - column + _GAP
        done += _column([d for d in side if count[d]], is_left, x, share, shown, height)
        done += [d for d in side if not count[d]]
    return done


def _column(
    side: list[Disc], left: bool, x: float, share: Mapping[str, float], shown: set[str], height: float
) -> list[Disc]:
    """Labels from top to bottom, as near to their discs' heights as they fit."""
    rows = [[n for n in d.joints if n in shown] for d in side]
    tops: list[float] = []
    for disc, names in zip(side, rows, strict=True):
        wish = disc.y - 0.5 * _LINE * (len(names) - 1)
        after = tops[-1] + _LINE * len(rows[len(tops) - 1]) + 4 if tops else 16.0
        tops.append(max(wish, after))
    limit = height - 12.0
    for i in reversed(range(len(tops))):
        tops[i] = min(tops[i], limit - _LINE * (len(rows[i]) - 1))
        limit = tops[i] - _LINE - 4
    out = []
    for disc, names, top in zip(side, rows, tops, strict=True):
        labels = []
        for i, name in enumerate(names):
            part = f" {share.get(name, 0.0):.0%}" if share else ""
            short = name if len(name) <= _LONGEST else name[: _LONGEST - 1] + "…"
            labels.append(Label(x, top + i * _LINE, left, short + part, name + part, share.get(name, 0.0)))
        out.append(replace(disc, labels=tuple(labels)))
    return out
