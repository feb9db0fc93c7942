"""Pictures of the report: robots and population in every pair of parameters, and errors of the channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from nfpde.corner.corner import STYLE
from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]

BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#9aa0a6"
MOST = 6
"""Parameters in the picture of pairs; those that the recordings narrow down least come first where there are more."""


def draw_pairs(
    space: ParameterSpace, population: Array, robots: Sequence[Mapping[str, Any]], shown: list[int]
) -> bytes:
    """PNG of marginals and pairs: the population as a cloud, every robot as a point with its 5 % to 95 % interval.

    Args:
        space: the parameters.
        population: samples, (n, D).
        robots: as in fit.json.
        shown: which parameters, in order.
    """
    n = len(shown)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(1.9 * n + 1.0, 1.9 * n + 0.6), layout="constrained")
        grid = figure.subplots(n, n, squeeze=False)
        for row in range(n):
            for column in range(n):
                ax = grid[row, column]
                if column > row:
                    ax.set_axis_off()
                    continue
                i, j = shown[row], shown[column]
                if row == column:
                    _marginal(ax, space, population[:, i], robots, i)
                else:
                    _pair(ax, space, population, robots, i, j)
                _label(ax, space, i, j, row == n - 1, column == 0 and row > 0)
        handles = [
            Line2D([], [], color=BLUE, marker="o", ls="", alpha=0.4, label="population"),
            Line2D([], [], color=ORANGE, marker="o", ls="-", label="robots, 5 % to 95 %"),
        ]
        figure.legend(handles=handles, loc="upper right", frameon=False)
        return _png(figure)


def draw_errors(residuals: Mapping[str, Mapping[str, float]]) -> bytes:
    """PNG of every channel's error before and after the fit, relative to before, on a logarithmic axis."""
    names = list(residuals)
    before = np.array([residuals[c]["before"] for c in names])
    after = np.array([residuals[c]["after"] for c in names])
    share = np.maximum(after / np.where(before > 0, before, 1.0), 1e-16)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.5, 0.22 * len(names) + 0.9), layout="constrained")
        ax = figure.subplots()
        places = np.arange(len(names))
        ax.hlines(places, share, 1.0, color=GREY, lw=1.2)
        ax.plot(np.ones(len(names)), places, "o", color=GREY, ms=4, label="parameters in the middle of their bounds")
        ax.plot(share, places, "o", color=BLUE, ms=5, label="fitted")
        ax.set_xscale("log")
        ax.set_yticks(places, names, parse_math=False)
        ax.invert_yaxis()
        ax.set_xlabel("root mean square error one window ahead, of the error before")
        ax.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
        return _png(figure)


def most_interesting(left: Sequence[float]) -> list[int]:
    """Which parameters to show: all in order, or the `MOST` that are known least where there are more."""
    if len(left) <= MOST:
        return list(range(len(left)))
    return sorted(int(i) for i in np.argsort(-np.asarray(left), kind="stable")[:MOST])


def _marginal(ax: Axes, space: ParameterSpace, xi: Array, robots: Sequence[Mapping[str, Any]], i: int) -> None:
    ax.hist(xi, bins=40, range=(space.low[i], space.high[i]), color=BLUE, alpha=0.35)
    top = ax.get_ylim()[1]
    for k, robot in enumerate(robots):
        p = robot["parameters"][space[i].name]
        height = top * (0.15 + 0.75 * (k + 0.5) / len(robots))
        ax.plot([p["5%"], p["95%"]], [height, height], color=ORANGE, lw=1.0)
        ax.plot(p["value"], height, "o", color=ORANGE, ms=2.5)
    ax.set_yticks([])


def _pair(ax: Axes, space: ParameterSpace, xi: Array, robots: Sequence[Mapping[str, Any]], i: int, j: int) -> None:
    ax.plot(xi[:, j], xi[:, i], ".", color=BLUE, alpha=0.12, ms=2.0, rasterized=True)
    for robot in robots:
        x, y = (robot["parameters"][space[k].name] for k in (j, i))
        ax.plot([x["5%"], x["95%"]], [y["value"]] * 2, color=ORANGE, lw=0.8)
        ax.plot([x["value"]] * 2, [y["5%"], y["95%"]], color=ORANGE, lw=0.8)
        ax.plot(x["value"], y["value"], "o", color=ORANGE, ms=2.5)
    ax.set_ylim(space.low[i], space.high[i])


def _label(ax: Axes, space: ParameterSpace, i: int, j: int, bottom: bool, left: bool) -> None:
    ax.set_xlim(space.low[j], space.high[j])
    # names are not formulas, whatever signs they hold
    if bottom:
        ax.set_xlabel(_short(space, j), parse_math=False)
    else:
        ax.set_xticklabels([])
    if left:
        ax.set_ylabel(_short(space, i), parse_math=False)
    elif i != j:
        ax.set_yticklabels([])


def _short(space: ParameterSpace, i: int) -> str:
    name = space[i].name
    name = name if len(name) <= 26 else name[:25] + "…"
    return f"{name}\n[{space[i].unit}]" if space[i].unit else name


def _png(figure: Figure) -> bytes:
    file = BytesIO()
    figure.savefig(file, dpi=110, format="png")
    return file.getvalue()
