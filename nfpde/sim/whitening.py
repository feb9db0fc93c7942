"""Residuals of windows turned into white innovations along an episode, and what whole recordings cost."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nfpde.errors import BadInput

Array = NDArray[np.float64]
Index = NDArray[np.intp]

DIVERGED = 1e30
"""Squared white innovation of a window whose simulation diverged, and the most there is."""


@dataclass(frozen=True, eq=False)
class Whitening:
    """White innovations e_t = own_t r_t - carry_t e_(t-1) of the residuals of N windows; multivariate Student t each.

    Windows that follow each other share a measured state, whose error `carry` takes out of the second one's residual.

    own: what turns a residual into a white innovation                     (N, C, C), or (1, C, C) if alike
    carry: what the innovation of the window before it takes from it       (N, C, C), or (1, C, C) if alike
    linked: whether a window goes on from the one before it in a recording (N,)
    degrees: degrees of freedom of the innovations; 1e6 is a Gaussian

    Raises:
        BadInput: shapes that do not fit each other, or degrees that are not positive.
    """

    own: Array
    carry: Array
    linked: NDArray[np.bool_]
    degrees: float

    def __post_init__(self) -> None:
        n, c = len(self.linked), self.own.shape[-1]
        for name in ("own", "carry"):
            shape = getattr(self, name).shape
            if shape not in ((n, c, c), (1, c, c)):
                raise BadInput(f"{name} must be of shape ({n}, {c}, {c}) or (1, {c}, {c}), got {shape}")
        if not self.degrees > 0:
            raise BadInput(f"degrees must be positive, got {self.degrees}")

    @property
    def channels(self) -> int:
        """Numbers in a window's residual, C."""
        return self.own.shape[-1]

    def whiten(self, residuals: Array, vector: Index, window: Index) -> Array:
        """White innovations of residuals (R, C), (R, C).

        A row that is not finite stays so, and takes nothing from the next.

        Args:
            residuals: of windows in recorded order, one parameter vector after the other, (R, C).
            vector: parameter vector of each row, sorted, (R,).
            window: window of each row, (R,).
        """
        white = np.empty_like(residuals)
        edges = np.flatnonzero(np.diff(vector, prepend=-1, append=-1))
        first = 0
        for here, after in pairwise(range(len(edges))):
            same = after + 1 < len(edges) and np.array_equal(
                window[edges[here] : edges[after]], window[edges[after] : edges[after + 1]]
            )
            if not same:
                # vectors with the same windows go side by side
                block = slice(edges[first], edges[after])
                shape = (after - first, -1, self.channels)
                own = window[edges[here] : edges[after]]
                white[block] = self.along(own, residuals[block].reshape(shape)).reshape(-1, self.channels)
                first = after
        return white

    def along(self, window: Index, residuals: Array) -> Array:
        """White innovations of many residuals of one recording: windows (n,) in order, (..., n, C) to (..., n, C).

        A row that is not finite stays so, and takes nothing from the next.
        """
        own = self.own if len(self.own) == 1 else self.own[window]
        with np.errstate(over="ignore", invalid="ignore"):
            flat = residuals.reshape(-1, *residuals.shape[-2:])
            # one product of matrices for every window, with all its residuals side by side
            white = np.ascontiguousarray((own @ flat.transpose(1, 2, 0)).transpose(2, 0, 1))
            for t in np.flatnonzero(self.linked[window][1:]) + 1:
                told = white[..., t - 1, :]
                carry = self.carry[window[t] if len(self.carry) > 1 else 0]
                white[..., t, :] -= np.where(np.isfinite(told), told, 0.0) @ carry.T
        return white.reshape(residuals.shape)

    def cost(self, white: Array) -> Array:
        """Twice the negative log density of white innovations, up to a constant, (..., C) to (...)."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = (white**2).sum(-1)
        squares = np.where(squares < DIVERGED, squares, DIVERGED)
        return (self.degrees + self.channels) * np.log1p(squares / self.degrees)

    def costs(self, residuals: Array, vector: Index, window: Index, m: int) -> Array:
        """Twice the negative log likelihood of each of m vectors, up to a constant, (m,); arguments as in `whiten`."""
        cost = self.cost(self.whiten(residuals, vector, window))
        return np.asarray(np.bincount(vector, weights=cost, minlength=m), np.float64)
