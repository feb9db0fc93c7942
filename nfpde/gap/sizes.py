"""Sizes of an effect to screen where contacts are.

Something that is touched holds, slips or lets go: what a large change does there is no multiple of what a small one
does. A servo that is much too stiff makes a wheel spin, and tells nothing of one that is a little too stiff.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Effect

Array = NDArray[np.float64]

SMALLEST = 0.01
"""Share of the way between the bounds that no size is more than once divided below."""

STEP = 4.0
"""From one size to the next: of what is right, a quarter gains almost half of what the whole does."""


def finer(effect: Effect, values: Array) -> Array:
    """The smallest values of every direction smaller and smaller, and to the other side where none points there.

    Args:
        effect: Whose values they are.
        values: To screen, (K, P).

    Returns:
        More values to screen, inside the bounds, (G, P); none for an effect that vanishes at infinity only.
    """
    neutral = np.array([q.neutral for q in effect.quantities])
    sized = np.array([not q.shape_only for q in effect.quantities])
    low, high = (np.array([getattr(p, side) for p in effect.parameters]) for side in ("low", "high"))
    if not np.isfinite(neutral[sized]).all():
        return values[:0]
    offset = np.where(sized, values - neutral, 0.0)
    way = offset / (high - low)
    far = np.abs(way).max(1)
    rows = list[Array]()
    for value, step, there, size in zip(values, offset, way, far, strict=True):
        if size == 0.0:
            continue
        alike = np.isclose(values, value)[:, ~sized].all(1)
        shares = way / np.maximum(far, 1e-300)[:, None]
        along, against = (np.isclose(shares, side * there / size).all(1) & alike for side in (1.0, -1.0))
        if size > far[along].min() * (1 + 1e-9):
            continue  # a smaller one points there, too
        count = max(0, int(np.ceil(np.log(size / SMALLEST) / np.log(STEP) - 1e-9)))
        parts = STEP ** -np.arange(1.0, count + 1)
        if not against.any():
            parts = np.concatenate([parts, [-1.0], -parts])
        rows += [np.where(sized, neutral + part * step, value) for part in parts]
    found = np.array(rows).reshape(-1, len(neutral))
    return found[((low <= found) & (found <= high)).all(1)]
