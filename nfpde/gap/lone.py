"""Windows that stand alone: a gap that shows in a few of them, far beyond all noise, and next to nothing in the mean.

`levels.rare` says how likely noise alone is to give them; here is which they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows

Array = NDArray[np.float64]

_MOST = 10
"""Groups of windows looked at, as in `levels.rare`."""

_FAR = 2.0
"""Times the largest gap that noise gives, from which a window is named in any case."""

_NAMED = 6
"""Places named in words, at most."""


def lone_windows(gap: Array, noise: Array, block: NDArray[np.intp]) -> NDArray[np.intp]:
    """Indices of the windows that noise is least likely to give, those with the largest gap first.

    Args:
        gap: Of every window (N,).
        noise: Gap that noise alone gives, N draws at least.
        block: Groups of neighbouring windows (N,), of which the largest counts.

    Returns:
        As many as make the set that is least likely, and all others that are `_FAR` beyond noise; none where no window
        is beyond all noise.
    """
    unit = max(float(noise.max(initial=0.0)), 1e-300)
    largest = np.sort([gap[block == g].max() for g in np.unique(block)])[::-1][:_MOST] / unit
    if not len(largest) or largest[0] <= 1.0:
        return np.zeros(0, np.intp)
    # logarithms: powers of what is far beyond are below all numbers
    likely = -np.arange(1, len(largest) + 1) * np.log1p(largest)
    bound = max(min(float(largest[int(likely.argmin())]), _FAR), 1.0)
    order = np.argsort(-gap, kind="stable")
    return order[gap[order] / unit >= bound]


def spoken(windows: Windows, names: Sequence[str]) -> str:
    """Where windows lie, in words: episodes and rows, windows that follow each other as one place.

    Args:
        windows: Some windows.
        names: Of the data set's episodes.
    """
    places = list[tuple[int, int, int]]()
    for n in np.lexsort((windows.row, windows.episode)):
        episode, first = int(windows.episode[n]), int(windows.row[n])
        last = first + windows.horizon
        # windows are cut a row apart
        if places and places[-1][0] == episode and first <= places[-1][2] + 1:
            places[-1] = episode, places[-1][1], last
        else:
            places.append((episode, first, last))
    said = [f"episode {names[episode]}, rows {first} to {last}" for episode, first, last in places[:_NAMED]]
    return "; ".join(said) + (f"; and {len(places) - _NAMED} more places" if len(places) > _NAMED else "")
