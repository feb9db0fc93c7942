"""Where the panels go: a triangle for a few parameters, a grid of marginals and some pairs for many."""

from __future__ import annotations

import math
import re

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.stats import rankdata

from nfpde.corner.content import Content
from nfpde.corner.panels import BOUND, ESTIMATE, LEVELS, NOMINAL, POPULATION, TRUTH, draw_marginal, draw_pair
from nfpde.parameters import ParameterSpace

Floats = NDArray[np.float64]
STRONGEST_PAIRS = 12
COLUMNS = 6
LINE = 17


def triangle(content: Content) -> Figure:
    """Marginals on the diagonal, pairs below it."""
    d = len(content.space)
    side = {1: 3.6, 2: 2.7}.get(d, max(1.5, 2.4 - 0.15 * d))
    figure = Figure(figsize=(d * side + 0.8, d * side + (1.3 if d == 1 else 0.7)), layout="constrained")
    axes = figure.subplots(d, d, squeeze=False)
    for row in range(d):
        for column in range(d):
            ax = axes[row, column]
            if column > row:
                ax.set_axis_off()
                continue
            if column == row:
                draw_marginal(ax, content, row)
            else:
                draw_pair(ax, content, column, row)
            if row == d - 1:
                ax.set_xlabel(_label(content.space, column))
            else:
                ax.tick_params(labelbottom=False)
            if column == 0 and row > 0:
                ax.set_ylabel(_label(content.space, row))
            elif column != row:
                ax.tick_params(labelleft=False)
    figure.align_labels()
    if d == 1:
        figure.legend(handles=_handles(content), loc="outside upper center", ncols=2, frameon=False)
    else:  # in the empty corner, from the second column on
        legend = axes[0, 1].legend(handles=_handles(content), loc="upper left", frameon=False, borderaxespad=0.0)
        legend.set_in_layout(False)
    return figure


def grid(content: Content) -> Figure:
    """All marginals, and under them the pairs with the strongest rank correlation."""
    d = len(content.space)
    pairs = strongest_pairs(content.xi, STRONGEST_PAIRS)
    rows, pair_rows = math.ceil(d / COLUMNS), math.ceil(len(pairs) / COLUMNS)
    heights = (1.8 * rows, 2.2 * pair_rows)
    figure = Figure(figsize=(2.15 * COLUMNS, sum(heights) + 1.0), layout="constrained")
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=heights).flat
    figure.set_layout_engine("constrained", w_pad=0.08, h_pad=0.06)
    upper.suptitle("Marginals", fontsize=11.0)
    for i, ax in enumerate(upper.subplots(rows, COLUMNS, squeeze=False).flat):
        if i >= d:
            ax.set_axis_off()
            continue
        draw_marginal(ax, content, i)
        ax.set_xlabel(_label(content.space, i))
    lower.suptitle("Pairs with the strongest rank correlation", fontsize=11.0)
    for k, ax in enumerate(lower.subplots(pair_rows, COLUMNS, squeeze=False).flat):
        if k >= len(pairs):
            ax.set_axis_off()
            continue
        i, j, correlation = pairs[k]
        draw_pair(ax, content, i, j)
        ax.set_xlabel(_label(content.space, i))
        ax.set_ylabel(_label(content.space, j))
        ax.set_title(f"{correlation:+.2f}", fontsize=9.0)
    figure.legend(handles=_handles(content), loc="outside upper center", ncols=5, frameon=False)
    return figure


def strongest_pairs(xi: Floats, count: int) -> list[tuple[int, int, float]]:
    """Pairs (i, j, rank correlation) with i < j of samples xi (n, D), strongest first, at most `count`."""
    ranks = np.column_stack([rankdata(column) for column in xi.T])
    ranks -= ranks.mean(0)
    norm = np.sqrt((ranks**2).sum(0))
    ranks /= np.where(norm > 0, norm, 1.0)  # a parameter that never varies has correlation 0
    correlation = ranks.T @ ranks
    i, j = np.triu_indices(xi.shape[1], 1)
    order = np.argsort(-np.abs(correlation[i, j]), kind="stable")[:count]
    return [(int(i[k]), int(j[k]), float(correlation[i[k], j[k]])) for k in order]


def _label(space: ParameterSpace, i: int) -> str:
    """Name and unit, in lines short enough for a panel."""
    head, colon, tail = space.names[i].partition(":")
    unit = f"[{space.units[i]}]" if space.units[i] else ""
    parts = [piece for part in (head, tail) for piece in _break(part)] if colon else _break(head)
    if unit and len(parts[-1]) + 1 + len(unit) <= LINE:
        parts[-1] += f" {unit}"
    elif unit:
        parts.append(unit)
    return "\n".join(parts).replace("$", r"\$")


def _break(text: str) -> list[str]:
    """Cut a name after underscores, plus signs and the like into lines of at most `LINE` characters."""
    lines = [""]
    for piece in re.split(r"(?<=[_+/. -])", text):
        if lines[-1] and len(lines[-1]) + len(piece) > LINE:
            lines.append("")
        lines[-1] += piece
    return [line[k : k + LINE] for line in lines for k in range(0, max(len(line), 1), LINE)]


def _handles(content: Content) -> list[Artist]:
    shares = " and ".join(f"{100 * share:.0f} %" for share in sorted(LEVELS))
    label = "estimate" if len(content.space) == 1 else f"estimate ({shares} regions)"
    handles: list[Artist] = [Patch(color=ESTIMATE, alpha=0.6, label=label)]
    if content.population is not None:
        handles.append(Line2D([], [], color=POPULATION, lw=1.3, label="true population"))
    if content.truth is not None:
        handles.append(Line2D([], [], color=TRUTH, marker="o", ls="", ms=5.0, label="true parameters"))
    if content.nominal is not None:
        handles.append(Line2D([], [], color=NOMINAL, ls="--", lw=0.9, label="the model's own"))
    handles.append(Patch(color=BOUND, alpha=0.35, label="outside the bounds"))
    return handles
