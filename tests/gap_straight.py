"""Replays and selections whose answers are known by arithmetic."""

import numpy as np

from nfpde.gap.replay import Replay
from nfpde.gap.select import Selection


class Straight(Replay):
    """Residuals A xi - b of one degree of freedom, whose bounds are far away."""

    effects = ()

    def __init__(self, matrix, target):
        self.matrix, self.target = matrix, target
        self.low, self.high = np.full(matrix.shape[-1], -50.0), np.full(matrix.shape[-1], 50.0)

    def residuals(self, xi, windows, horizons, force=None):
        return (np.einsum("ncd,md->mnc", self.matrix, xi) - self.target)[:, :, None]


class Change:
    """A replay of a base that leaves `start`, and of one effect that adds `change` times its value."""

    def __init__(self, start, change, effects=()):
        self.start, self.change, self.effects = start, change, effects
        self.nfree, self.low, self.high = 1, np.zeros(1), np.ones(1)

    def inward(self, xi):
        return xi

    def outward(self, u):
        return u

    def residuals(self, xi, windows, horizons, force=None):
        return self.start + xi[:, :1, None, None] * self.change


class ByGain(Selection):
    """A selection that has no windows whose slopes it could ask."""

    def slope(self, trial, current):
        return 1.0
