"""Rows of the model's fields that are multiples of parameters, of all vectors at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TRIED = 32
"""Random vectors whose rows must come out as they should."""

EXACT = 1e-13
"""Relative difference up to which two products are the same number in double precision, before they are rounded."""


@dataclass(frozen=True, eq=False)
class LinearRows:
    """Rows of which each number is a constant or a multiple of one parameter, as masses and dampings are.

    A GPU waits for the parameters of a call, and writing them field by field takes ten times as long.

    base: the row, with what no parameter changes                          (W,)
    columns: those that are multiples                                      (K,)
    parameters: of which parameter each                                    (K,)
    factors: how many times it                                             (K,)
    """

    base: NDArray[np.float32]
    columns: NDArray[np.intp]
    parameters: NDArray[np.intp]
    factors: Array

    @classmethod
    def of(cls, rows: Callable[[Array], Array], low: Array, high: Array) -> LinearRows | None:
        """Found by asking for rows at some vectors; None where they are anything else.

        Args:
            rows: from vectors (M, D) to rows (M, W).
            low: lower bounds of the parameters, (D,).
            high: upper bounds, (D,).
        """
        inside = 0.4 * low + 0.6 * high
        if not inside.all():  # at zero no factor can be read off
            return None
        moved = np.tile(inside, (len(inside), 1))
        np.fill_diagonal(moved, 0.7 * low + 0.3 * high)
        base = rows(inside[None])[0]
        parameters, columns = np.nonzero(rows(moved) != base)
        found = cls(base.astype(np.float32), columns, parameters, base[columns] / inside[parameters])
        tried = np.random.default_rng(0).uniform(low, high, (TRIED, len(low)))
        wanted, fixed = rows(tried), np.setdiff1d(np.arange(len(base)), columns)
        products = found.factors * tried[:, parameters]
        same = np.allclose(products, wanted[:, columns], rtol=EXACT, atol=0) and (wanted[:, fixed] == base[fixed]).all()
        return found if same else None

    def __call__(self, xi: Array) -> NDArray[np.float32]:
        """Of vectors (M, D) the rows (M, W)."""
        out = np.tile(self.base, (len(xi), 1))
        out[:, self.columns] = self.factors * xi[:, self.parameters]
        return out
