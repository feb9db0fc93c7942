"""Faster ways to the fixed point of a map."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MEMORY = 6
"""Steps that are remembered."""

DEPENDENT = 1e-6
"""Share of the largest singular value below which remembered steps are combinations of others."""


@dataclass
class Anderson:
    """Steps to the fixed point of a map from what its last steps did: Newton's, in the directions these have tried.

    Reference: Walker, Ni, Anderson acceleration for fixed-point iterations, SIAM Journal on Numerical Analysis 49,
    2011.

    places: where the map was asked                                        arrays (K,)
    moves: how far it moved each of them                                   arrays (K,)
    """

    places: list[Array] = field(default_factory=list)
    moves: list[Array] = field(default_factory=list)

    def step(self, place: Array, move: Array) -> Array:
        """Where to go from a place that the map moves by `move`, relative to the place, (K,); `move` at first."""
        self.places = [*self.places, place][-MEMORY - 1 :]
        self.moves = [*self.moves, move][-MEMORY - 1 :]
        if len(self.places) < 2:
            return move
        went, changed = np.diff(self.places, axis=0).T, np.diff(self.moves, axis=0).T
        shares = np.linalg.lstsq(changed, move, rcond=DEPENDENT)[0]
        return move - (went + changed) @ shares

    def forget(self) -> None:
        """Begin anew: the last step led astray."""
        self.places, self.moves = self.places[-1:], self.moves[-1:]
