"""`summary.png`: the ladder and the robot, for a slide or a message."""

from __future__ import annotations

import math
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from nfpde.gap.drawing import project
from nfpde.gap.drawing_layout import TEXT, Layout, lay_out
from nfpde.gap.html_causes import powers, scale
from nfpde.gap.html_robot import shares
from nfpde.gap.html_svg import percent, shade
from nfpde.gap.report import GapReport
from nfpde.storage import write_picture

_WIDE, _HIGH, _PART = 13.0, 5.2, 0.55
"""Size [in], and the robot's part of the width."""

_BLUE, _RED, _GREEN = "#0072B2", "#D55E00", "#009E73"


def draw_summary(report: GapReport, path: Path) -> Path:
    """Draw the ladder and the robot into a picture file; returns its path."""
    layout = lay_out(project(report.model), shares(report))
    figure = Figure(figsize=(_WIDE, _HIGH))
    _ladder(figure.add_axes((0.135, 0.1, 0.285, 0.8)), report)
    _robot(figure.add_axes((1 - _PART, 0.02, _PART, 0.88)), layout, bool(shares(report)))
    return write_picture(path, figure, dpi=120)


def _ladder(ax: Axes, report: GapReport) -> None:
    labels, values = (
        [_plain(label.replace(" at ", "\nat "), 44) for label, _ in report.ladder],
        [v for _, v in report.ladder],
    )
    low, high = scale(values)
    rows = range(len(values))
    colours = [_RED, *[_BLUE] * (len(values) - 2), _GREEN][: len(values)]
    drawn = [min(max(v, 10.0**low), 10.0**high) if math.isfinite(v) else 10.0**high for v in values]
    ax.barh(rows, drawn, color=colours, left=0)
    for row, value, at in zip(rows, values, drawn, strict=True):
        ax.text(at * 1.1, row, percent(value), va="center", fontsize=11, fontweight="bold")
    ax.set_xscale("log")
    ax.set_xlim(10.0**low, 10.0**high * 10 ** (0.2 * (high - low)))
    ticks = powers(low, high)
    ax.set_xticks(ticks, [percent(t) for t in ticks])
    ax.minorticks_off()
    ax.set_yticks(list(rows), labels)
    ax.invert_yaxis()
    ax.spines[["top", "right"]].set_visible(False)
    ax.set_title("How far the gap shrinks (held-out episodes)", fontsize=12, loc="left")


def _robot(ax: Axes, layout: Layout, coloured: bool) -> None:
    letters = 72 * TEXT * min(_PART * _WIDE / layout.width, 0.88 * _HIGH / layout.height)
    top = max([d.share for d in layout.discs] or [0.0]) or 1.0
    if layout.ground is not None:
        ax.plot([150, layout.width - 150], [layout.ground] * 2, color="#8a949e", ls="--", lw=1)
    for outline, fixed in zip(layout.outlines, layout.fixed, strict=True):
        face = "#e3e7eb" if fixed else "#c3cad2"
        ax.add_patch(Polygon(outline.tolist(), closed=True, fc=face, ec="#6c7782", alpha=0.8, lw=1))
    for disc in sorted(layout.discs, key=lambda d: (-d.radius, d.x, d.y)):
        fill = shade(disc.share / top)[0] if coloured else "white"
        ax.add_patch(Circle((disc.x, disc.y), disc.radius, fc=fill, ec="#1d2126", lw=1, zorder=3))
        if disc.labels:
            first, last = disc.labels[0], disc.labels[-1]
            end = first.x + (4 if first.left else -4)
            ax.plot([disc.x, end], [disc.y, 0.5 * (first.y + last.y) - 4], color="#8a949e", lw=0.7, zorder=2)
        for label in disc.labels:
            ax.text(
                label.x,
                label.y,
                _plain(label.text, 99),
                ha="right" if label.left else "left",
                fontsize=letters,
                fontweight="bold" if label.share >= 0.1 else "normal",
            )
    ax.set_xlim(0, layout.width)
    ax.set_ylim(layout.height, 0)
    ax.set_aspect("equal")
    ax.axis("off")
    title = "Where it lies: joints by their share of the gap" if coloured else "No gap to place"
    ax.set_title(title, fontsize=12, loc="left")


def _plain(label: str, most: int) -> str:
    """Text that matplotlib does not take for a formula, cut where it is too long."""
    return (label if len(label) <= most else label[: most - 1] + "…").replace("$", r"\$")
