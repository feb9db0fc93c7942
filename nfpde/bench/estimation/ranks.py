"""Calibration by simulation: ranks of true values among posterior samples, coverage, and their histograms.

Reference: Talts, Betancourt, Simpson, Vehtari, Gelman, Validating Bayesian inference algorithms with simulation-based
calibration, 2018.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binom

from nfpde.storage import write_picture

Array = NDArray[np.float64]

BINS = 10
BAND = 0.99
"""Share of the bins of a calibrated estimator that lies inside the grey band."""

WANTED = {"50": (0.45, 0.55), "90": (0.85, 0.95)}
"""Pooled coverage of the central regions that counts as calibrated."""


def rank_of(true: Array, samples: Array) -> NDArray[np.intp]:
    """How many of the samples (L, D) lie below the true values (D,), for each parameter (D,): 0 to L."""
    return (samples < true).sum(0)


def coverage(ranks: ArrayLike, samples: int, share: float) -> dict[str, Any]:
    """How often true values lie in the central region that holds `share` of the posterior.

    Args:
        ranks: among the samples (P, D), of P problems.
        samples: number of samples L of a problem.
        share: of the region, between 0 and 1.

    Returns:
        by_parameter: covered share (D,), and `error`, its binomial standard error were the estimator calibrated
        pooled: mean of all; pooled_error: its standard error, problems taken as independent and the parameters of
        one problem not
    """
    inside = np.abs((np.asarray(ranks) + 0.5) / (samples + 1) - 0.5) <= share / 2
    problems = len(inside)
    means = inside.mean(1)
    spread = means.std(ddof=1) / np.sqrt(problems) if problems > 1 else np.nan
    return {
        "by_parameter": inside.mean(0).tolist(),
        "error": float(np.sqrt(share * (1 - share) / problems)),
        "pooled": float(inside.mean()),
        "pooled_error": float(spread) if np.isfinite(spread) else None,
    }


def histogram(ranks: ArrayLike, samples: int) -> list[list[int]]:
    """Counts of the ranks (P, D) in `BINS` equal bins, one list a parameter; flat where the estimator is calibrated."""
    bins = np.minimum(np.asarray(ranks) * BINS // (samples + 1), BINS - 1)
    return [np.bincount(column, minlength=BINS).tolist() for column in bins.T]


def draw_ranks(ranks: ArrayLike, samples: int, names: Sequence[str], title: str, path: Path) -> Path:
    """Write the histograms to a PNG, with the band in which 99 % of the bins of a calibrated estimator lie."""
    counts = histogram(ranks, samples)
    problems = len(np.asarray(ranks))
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(3.2 * columns, 2.2 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    low, high = binom.interval(BAND, problems, 1 / BINS)
    for ax, name, heights in zip(axes, names, counts, strict=False):
        ax.axhspan(low, high, color="0.88")
        ax.axhline(problems / BINS, color="0.5", lw=0.8)
        ax.bar((np.arange(BINS) + 0.5) / BINS, heights, width=0.9 / BINS, color="#0072B2")
        ax.set_title(name, fontsize=9, loc="left")
        ax.set_xlim(0, 1)
        ax.tick_params(labelsize=8)
        ax.spines[["top", "right"]].set_visible(False)
    for ax in axes[len(names) :]:
        ax.set_axis_off()
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    figure.supxlabel("rank of the true value among posterior samples, as a share", fontsize=8)
    return write_picture(path, figure, dpi=150)
