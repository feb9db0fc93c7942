"""Pictures of a fit: the distribution, and how the fit went."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from nfpde.corner import corner
from nfpde.estimation.result import FitResult
from nfpde.storage import write_picture

_PANELS = {
    "loss": "squared error of what explains the data",
    "noise": "typical residual, as learned from the data",
    "held_out": "log likelihood of robots left out, above that under the bounds alone [nats]",
    "beta": "temperature beta",
    "effective": "effective samples",
}


def draw_fit(result: FitResult, folder: str | Path, nominal: ArrayLike | None = None) -> dict[Path, str]:
    """Write corner.png and progress.png into a folder; returns what each picture shows.

    Args:
        result: of `fit`.
        folder: where to.
        nominal: the model's own parameters, (D,), drawn as dashed lines.
    """
    folder = Path(folder)
    return {
        corner(
            result.distribution, folder / "corner.png", nominal=nominal
        ): "the fitted distribution within its bounds",
        _draw_history(result, folder / "progress.png"): "how the fit went: a loss that no longer falls has converged",
    }


def _draw_history(result: FitResult, path: Path) -> Path:
    # the rounds of the population have other figures than those of the robots
    panels = {k: v for k, v in _PANELS.items() if any(k in row for row in result.history)}
    figure = Figure(figsize=(7.0, 2.0 * len(panels) + 0.6), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for ax, (key, text) in zip(axes, panels.items(), strict=True):
        rows = [row for row in result.history if key in row]
        ax.plot([row["iteration"] for row in rows], [row[key] for row in rows], ".-", color="#0072B2", lw=1.5)
        ax.set_title(text, fontsize=10, loc="left")
        if key not in ("effective", "held_out") and all(row[key] > 0 for row in rows):
            ax.set_yscale("log")
        ax.grid(alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    axes[-1].set_xlabel("iteration")
    return write_picture(path, figure, dpi=150)
