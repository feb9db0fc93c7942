"""The picture of a training: returns where it trains and in the target, against control steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from nfpde.rl.history import Point, Score, TrainResult
from nfpde.storage import write_picture

TRAINING, TARGET, NOMINAL, EXPLORING = "#2a6f97", "#d1495b", "#6b7280", "#9fc3d9"


def plot_returns(result: TrainResult, path: Path | str) -> None:
    """Draw `returns.png`: mean returns without exploration, bands of one standard error, faint the exploring ones."""
    figure = Figure(figsize=(7.2, 4.2), dpi=160, layout="constrained")
    axes = figure.add_subplot()
    points = result.points
    exploring = [(p.step, p.exploring) for p in points if p.exploring is not None]
    if exploring:
        steps, values = zip(*exploring, strict=True)
        axes.plot(steps, values, color=EXPLORING, lw=1, marker="o", ms=3, label="training, exploring")
    _line(axes, points, [p.training for p in points], TRAINING, "training parameters")
    _line(axes, points, [p.target for p in points], TARGET, "target")
    baseline = result.baseline
    if baseline is not None:
        scores = [p.training if p.target is None else p.target for p in baseline.points]
        where = "target" if baseline.after.target is not None else "nominal model"
        _line(axes, baseline.points, scores, NOMINAL, f"{where}, trained on the nominal model", "--")
    axes.set_xlabel("control steps")
    axes.set_ylabel("return of an episode")
    axes.set_title(str(result.settings.get("environment", "")), loc="left", fontsize=11, fontweight="bold")
    axes.set_xlim(0, max(p.step for p in points) or 1)
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}"))
    axes.grid(True, color="#e5e7eb", lw=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(frameon=False, fontsize=9, loc="best")
    write_picture(Path(path), figure, dpi=figure.dpi)


def _line(
    axes: Any,
    points: tuple[Point, ...],
    scores: list[Score] | list[Score | None],
    color: str,
    label: str,
    style: str = "-",
) -> None:
    """One curve with its band; gaps where a simulation diverged."""
    if all(s is None for s in scores):
        return
    steps = np.array([p.step for p in points])
    mean = np.array([np.nan if s is None or s.mean is None else s.mean for s in scores])
    error = np.array([np.nan if s is None or s.standard_error is None else s.standard_error for s in scores])
    axes.fill_between(steps, mean - error, mean + error, color=color, alpha=0.18, lw=0)
    axes.plot(steps, mean, style, color=color, lw=2, label=label)
