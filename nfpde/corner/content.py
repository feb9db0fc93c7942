"""What a picture shows, checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.errors import BadInput, NfpdeError
from nfpde.parameters import ParameterSpace

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Content:
    """All that is drawn.

    Args:
        space: The parameters.
        xi: Samples (n, D).
        truth: True parameters (E, D).
        population: Draws of the true population (m, D).
        nominal: The model's own values (D,), NaN where there is none.
        limits: First and last value shown, for each parameter.
    """

    space: ParameterSpace
    xi: Floats
    truth: Floats | None
    population: Floats | None
    nominal: Floats | None
    limits: list[tuple[float, float]]


def make_content(
    space: ParameterSpace,
    xi: ArrayLike,
    truth: ArrayLike | None,
    population: ArrayLike | None,
    nominal: ArrayLike | None,
    zoom: bool,
) -> Content:
    """Check what is drawn, see `corner`, and choose the limits."""
    points = _points("samples", xi, space)
    if len(points) < 2:
        raise BadInput(f"a picture of a distribution needs at least 2 samples, got {len(points)}")
    true = None if truth is None else _points("truth", truth, space)
    drawn = None if population is None else _points("population", population, space)
    if drawn is not None and len(drawn) < 2:
        raise BadInput(f"a population is drawn from at least 2 draws of it, got {len(drawn)}")
    try:
        own = None if nominal is None else np.asarray(nominal, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadInput(f"nominal must be {len(space)} numbers, one a parameter, got {nominal!r}") from None
    if own is not None and own.shape != (len(space),):
        raise BadInput(f"nominal must have shape ({len(space)},), one value a parameter, got {own.shape}")
    low, high = space.low, space.high
    if zoom:
        shown = np.concatenate([p for p in (points, true, drawn) if p is not None])
        low, high = shown.min(0), shown.max(0)
    pad = np.maximum(0.05 * (high - low), 1e-4 * space.width)
    limits = [(float(a), float(b)) for a, b in zip(low - pad, high + pad, strict=True)]
    return Content(space, points, true, drawn, own, limits)


def _points(name: str, values: ArrayLike, space: ParameterSpace) -> Floats:
    try:
        return space.check(values)
    except NfpdeError as error:
        raise BadInput(f"{name}: {error}") from None
