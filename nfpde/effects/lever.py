"""Effects of some strength about some place, and the coordinates in which what they do is linear."""

from __future__ import annotations

import numpy as np

from nfpde.effects.effect import Array, Effect


class Lever(Effect):
    """An effect whose first quantity is a strength, its others the place where that is found: mass, stiffness.

    A little far out does much the same as much close by: in strength and place a curved valley. Strength and first
    moment about the middle of the places add up.
    """

    def together(self, values: Array, shares: Array) -> Array:
        """The strengths' sum at their common centre."""
        return self.bent(shares @ self.straightened(values))

    def straightened(self, values: Array) -> Array:
        """Strength and first moment about the middle of the places (..., P)."""
        middle, _ = self._places()
        return np.concatenate([values[..., :1], values[..., :1] * (values[..., 1:] - middle)], axis=-1)

    def bent(self, coordinates: Array) -> Array:
        """Strength and place; a moment that no place within the bounds gives is brought down to one that does."""
        middle, far = self._places()
        strength = coordinates[..., :1]
        place = np.divide(coordinates[..., 1:], strength, out=np.zeros_like(coordinates[..., 1:]), where=strength > 0)
        return np.concatenate([strength, middle + np.clip(place, -far, far)], axis=-1)

    def straight_bounds(self) -> tuple[Array, Array]:
        """Every strength, and the moments of the greatest."""
        _, far = self._places()
        strength = self.parameters[0]
        return np.array([strength.low, *(-strength.high * far)]), np.array([strength.high, *(strength.high * far)])

    def _places(self) -> tuple[Array, Array]:
        """Middle and half widths of the places (P - 1,)."""
        low, high = (np.array([getattr(p, side) for p in self.parameters[1:]]) for side in ("low", "high"))
        return 0.5 * (low + high), 0.5 * (high - low)
