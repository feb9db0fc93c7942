"""`corner`: what a distribution says about each parameter and each pair of them, as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol, cast

import matplotlib
import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.corner.content import make_content
from nfpde.corner.layout import grid, triangle
from nfpde.errors import BadInput
from nfpde.parameters import ParameterSpace
from nfpde.storage import write_picture

STYLE: Any = {
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-3, 4),
}


class Sampler(Protocol):
    """What can be drawn: a `ParameterDistribution`, or anything with a space and samples."""

    @property
    def space(self) -> ParameterSpace:
        """The parameters."""
        ...

    def sample(self, n: int, seed: int = 0) -> NDArray[np.float64]:
        """Draw n parameter vectors (n, D) in physical units."""
        ...


def corner(
    source: Sampler | ArrayLike,
    path: Path | str,
    *,
    space: ParameterSpace | None = None,
    truth: ArrayLike | None = None,
    population: ArrayLike | None = None,
    nominal: ArrayLike | None = None,
    zoom: bool = False,
    max_dimensions: int = 10,
    samples: int = 4000,
    seed: int = 0,
) -> Path:
    """Draw marginals and pairwise densities to a PNG file.

    Up to `max_dimensions` parameters: marginals on the diagonal, pairs below it. More: a grid of all marginals,
    and under it the pairs with the strongest rank correlation. Grey bands lie outside the bounds. Pairs show the
    smallest regions that hold 50 % and 90 % of the samples.

    Args:
        source: A distribution, or samples of one (n, D) in physical units.
        path: Where to write the picture; folders are made where they are missing.
        space: The parameters of the samples; a distribution has its own.
        truth: True parameters (E, D), drawn as points.
        population: Draws of the true population (m, D), drawn as outlines.
        nominal: The model's own values (D,), drawn as dashed lines; NaN where there is none.
        zoom: Show only the range of what is drawn, not the whole box.
        max_dimensions: The most parameters for the full triangle.
        samples: Number of samples to draw from a distribution.
        seed: Of those samples.

    Returns:
        The path.

    Raises:
        BadInput: Arrays that do not fit the space or leave its box, samples without a space, or fewer than 2 of them.
    """
    if hasattr(source, "sample"):
        if space is not None:
            raise BadInput("a distribution has its own space; leave out the argument space")
        sampler = cast(Sampler, source)
        space, xi = sampler.space, sampler.sample(samples, seed)
    elif space is None:
        raise BadInput("samples need their parameters: corner(samples, path, space=...)")
    else:
        xi = cast(ArrayLike, source)
    content = make_content(space, xi, truth, population, nominal, zoom)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(STYLE):
        figure = triangle(content) if len(content.space) <= max_dimensions else grid(content)
        return write_picture(path, figure, dpi=150)
