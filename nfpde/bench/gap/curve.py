"""Accuracy over the size of the effect, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

from nfpde.bench.gap.score import Row
from nfpde.bench.gap.summary import by_size, wilson


def draw_curve(rows: Sequence[Row], path: Path) -> None:
    """Write a PNG: share of right causes and places of single effects by size over the noise, with intervals."""
    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    bins = [b for b in by_size(rows) if b["cases"]]
    figure = Figure(figsize=(6.4, 4), layout="constrained")
    axes = figure.add_subplot()
    for key, label, colour, shift in (
        ("cause", "right cause", "#1f77b4", 0.97),
        ("place", "right place", "#d95f02", 1.03),
    ):
        x = [shift * (b["low"] * (b["high"] or 3 * b["low"])) ** 0.5 for b in bins]
        y = [b[key] for b in bins]
        ends = [wilson(b[key], b["cases"]) for b in bins]
        bars = [
            [v - low for v, (low, _) in zip(y, ends, strict=True)],
            [high - v for v, (_, high) in zip(y, ends, strict=True)],
        ]
        axes.errorbar(
            x, y, yerr=[[max(e, 0.0) for e in side] for side in bars], fmt="o-", capsize=3, color=colour, label=label
        )
    for b in bins:
        axes.annotate(
            f"n={b['cases']}", ((b["low"] * (b["high"] or 3 * b["low"])) ** 0.5, 0.02), ha="center", fontsize=8
        )
    axes.set(xscale="log", ylim=(0, 1.05), xlabel="size of the effect over the noise", ylabel="share of cases")
    axes.grid(alpha=0.3)
    axes.legend(loc="center right")
    figure.savefig(path, dpi=120)
