"""The two kinds of panels: one parameter's marginal, and a pair's density."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from nfpde.corner.content import Content
from nfpde.parameters import ParameterSpace

Floats = NDArray[np.float64]

# colours that stay apart for all common kinds of colour blindness (Okabe and Ito, Color Universal Design, 2008)
ESTIMATE, TRUTH, POPULATION, NOMINAL, BOUND = "#0072B2", "#D55E00", "#009E73", "#000000", "#999999"
LEVELS = (0.9, 0.5)


def draw_marginal(ax: Axes, content: Content, i: int) -> None:
    """Draw the histogram of parameter i."""
    low, high = content.limits[i]
    heights, edges = _histogram(content.xi[:, i], content.space, i, 40)
    ax.stairs(heights, edges, fill=True, color=ESTIMATE, alpha=0.35)
    ax.stairs(heights, edges, color=ESTIMATE, lw=1.0)
    top = float(heights.max())
    if content.population is not None:
        heights, edges = _histogram(content.population[:, i], content.space, i, 30)
        ax.stairs(heights, edges, color=POPULATION, lw=1.3)
        top = max(top, float(heights.max()))
    if content.truth is not None:
        values = content.truth[:, i]
        ax.plot(values, np.full(len(values), 0.045 * top), "|", color=TRUTH, ms=9.0, mew=1.4, zorder=5)
    if content.nominal is not None:
        ax.axvline(content.nominal[i], color=NOMINAL, ls="--", lw=0.9)
    ax.set_ylim(0.0, 1.12 * top)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    _bounds(ax.axvspan, ax.axvline, content, i)
    ax.set_xlim(low, high)
    ax.xaxis.set_major_locator(MaxNLocator(3))


def draw_pair(ax: Axes, content: Content, i: int, j: int) -> None:
    """Draw the density of parameters i (across) and j (up)."""
    _bounds(ax.axvspan, ax.axvline, content, i)
    _bounds(ax.axhspan, ax.axhline, content, j)
    x, y, density, levels = regions(content.xi[:, [i, j]], content.space, i, j)
    ax.contourf(x, y, density, levels=[*levels, np.inf], colors=[ESTIMATE, ESTIMATE], alpha=0.30)
    ax.contourf(x, y, density, levels=[levels[-1], np.inf], colors=[ESTIMATE], alpha=0.45)
    ax.contour(x, y, density, levels=levels, colors=ESTIMATE, linewidths=0.8)
    if content.population is not None:
        x, y, density, levels = regions(content.population[:, [i, j]], content.space, i, j)
        ax.contour(x, y, density, levels=levels, colors=POPULATION, linewidths=1.2)
    if content.nominal is not None:
        ax.axvline(content.nominal[i], color=NOMINAL, ls="--", lw=0.9)
        ax.axhline(content.nominal[j], color=NOMINAL, ls="--", lw=0.9)
    if content.truth is not None:
        ax.plot(content.truth[:, i], content.truth[:, j], "o", color=TRUTH, ms=4.0, mec="white", mew=0.5, zorder=5)
    ax.set_xlim(*content.limits[i])
    ax.set_ylim(*content.limits[j])
    ax.xaxis.set_major_locator(MaxNLocator(3))
    ax.yaxis.set_major_locator(MaxNLocator(3))


def _bounds(span: Callable[..., Any], line: Callable[..., Any], content: Content, i: int) -> None:
    """Grey what lies outside the bounds of parameter i."""
    low, high = float(content.space.low[i]), float(content.space.high[i])
    for outside, bound in ((low - content.space.width[i], low), (high + content.space.width[i], high)):
        span(min(outside, bound), max(outside, bound), color=BOUND, alpha=0.25, lw=0.0, zorder=0)
        line(bound, color=BOUND, lw=0.8, zorder=0.5)


def _histogram(values: Floats, space: ParameterSpace, i: int, count: int) -> tuple[Floats, Floats]:
    """Densities and edges of a histogram of parameter i."""
    edges = _bins(values, space.low[i], space.high[i], count)
    heights, _ = np.histogram(values, bins=edges, density=True)
    return heights, edges


def _bins(values: Floats, low: float, high: float, count: int) -> Floats:
    """Edges of `count` bins over the range of the values, cut at the bounds."""
    first, last = float(values.min()), float(values.max())
    pad = max(0.02 * (last - first), 1e-4 * (high - low))
    return np.linspace(max(low, first - pad), min(high, last + pad), count + 1)


def regions(xi: Floats, space: ParameterSpace, i: int, j: int) -> tuple[Floats, Floats, Floats, list[float]]:
    """A smoothed histogram of pairs and the heights whose regions hold 90 % and 50 % of them, rising."""
    edges = [_bins(xi[:, k], space.low[axis], space.high[axis], 48) for k, axis in enumerate((i, j))]
    density, _, _ = np.histogram2d(xi[:, 0], xi[:, 1], bins=edges)
    smooth = gaussian_filter(density.T, 1.6, mode="nearest")
    falling = np.sort(smooth, axis=None)[::-1]
    mass = np.cumsum(falling)
    levels = [float(falling[np.searchsorted(mass, share * mass[-1])]) for share in LEVELS]
    if levels[0] == levels[1]:  # a plateau: contours need rising levels
        levels[0] *= 1 - 1e-6
    # an empty rim closes the contours that reach the edge of the histogram
    centres = [np.concatenate([e[:1], (e[:-1] + e[1:]) / 2, e[-1:]]) for e in edges]
    return centres[0], centres[1], np.pad(smooth, 1), levels
