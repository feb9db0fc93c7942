"""Residuals of windows turned into white innovations along an episode, and what whole recordings cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nfpde.errors import BadInput

Array = NDArray[np.float64]
Index = NDArray[np.intp]

DIVERGED = 1e30
"""Squared white innovation of a window whose simulation diverged, and the most there is."""

NUMBERS_AT_ONCE = 1 << 22
"""Numbers of gathered matrices that are held at once, about (32 MiB)."""


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
        step = max(1, NUMBERS_AT_ONCE // self.channels**2)
        with np.errstate(over="ignore", invalid="ignore"):
            for start in range(0, len(white), step):
                part = slice(start, start + step)
                white[part] = _apply(self.own, window[part], residuals[part])
            for now in self._linked_rows(vector, window):
                told = white[now - 1]
                white[now] -= _apply(self.carry, window[now], np.where(np.isfinite(told), told, 0.0))
        return white

    def costs(self, residuals: Array, vector: Index, window: Index, m: int) -> Array:
        """Twice the negative log likelihood of each of m vectors, up to a constant, (m,); arguments as in `whiten`."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = (self.whiten(residuals, vector, window) ** 2).sum(1)
        squares = np.where(squares < DIVERGED, squares, DIVERGED)
        cost = (self.degrees + self.channels) * np.log1p(squares / self.degrees)
        return np.asarray(np.bincount(vector, weights=cost, minlength=m), np.float64)

    def _linked_rows(self, vector: Index, window: Index) -> list[Index]:
        """Rows that go on from the row before them: first those whose predecessor goes on from none, and so on."""
        linked = self.linked[window]
        linked[:1] = False
        linked[1:] &= vector[1:] == vector[:-1]
        if not linked.any():
            return []
        every = np.arange(len(linked))
        place = every - np.maximum.accumulate(np.where(linked, 0, every))
        order = np.argsort(place, kind="stable")
        return np.split(order, np.cumsum(np.bincount(place))[:-1])[1:]


def _apply(matrices: Array, window: Index, rows: Array) -> Array:
    """Each window's own matrix times its row, (R, C)."""
    if len(matrices) == 1:
        return rows @ matrices[0].T
    return np.einsum("rij,rj->ri", matrices[window], rows)
