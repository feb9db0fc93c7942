"""Accuracy over the size of the effect, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

from nfpde.bench.gap.score import Row
from nfpde.bench.gap.summary import by_size, wilson
from nfpde.storage import write_picture

SERIES = (
    ("cause", "cases", "right cause", "#1f77b4", 0.92),
    ("place", "cases", "right place", "#d95f02", 1.0),
    ("both", "pairs", "both of a pair, by the lesser size", "#1b9e77", 1.09),
)
"""What is drawn: share, number of cases behind it, label, colour, and shift along the axis so that bars stand apart."""


def draw_curve(rows: Sequence[Row], path: Path) -> None:
    """Write a PNG: right causes and places of single effects, and pairs, by size over the noise, with intervals."""
    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    bins = [b | {"middle": (b["low"] * (b["high"] or 3 * b["low"])) ** 0.5} for b in by_size(rows)]
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.add_subplot()
    for key, count, label, colour, shift in SERIES:
        mine = [b for b in bins if b[count]]
        share = [b[key] for b in mine]
        ends = [wilson(b[key], b[count]) for b in mine]
        bars = [
            [max(s - low, 0.0) for s, (low, _) in zip(share, ends, strict=True)],
            [max(high - s, 0.0) for s, (_, high) in zip(share, ends, strict=True)],
        ]
        x = [shift * b["middle"] for b in mine]
        axes.errorbar(x, share, yerr=bars, fmt="o-", capsize=3, color=colour, label=label)
    for b in bins:
        if b["cases"] or b["pairs"]:
            axes.annotate(f"{b['cases']} + {b['pairs']}", (b["middle"], 0.02), ha="center", fontsize=8)
    axes.set(xscale="log", ylim=(0, 1.05), xlabel="size of the effect over the noise (single effects + pairs)")
    axes.set_ylabel("share of cases")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=3, fontsize=9)
    write_picture(path, figure, dpi=120)
