"""Rounds of samples that gather about the best of them, led by a linear model of the residuals.

Contacts open and close, and each change makes a small step in the residuals: differences over short distances say
nothing of the way to the best value. A linear model through samples far apart does, and what the steps add to it
averages out over the samples. Every round is taken closer than the last.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.chart import Chart
from nfpde.gap.fit import Fitter
from nfpde.gap.levels import calm
from nfpde.gap.replay import Replay

Array = NDArray[np.float64]

_CLOSER = 0.6
"""Width of a round as a share of that of the round before."""

_REACH = 3.0
"""How far, in widths, samples count in the linear model, and how far it may step."""

_DAMPINGS = (1e-3, 0.5)

_TAIL = 2.0
"""Residual, in standard deviations of its channel, that counts half."""


def spread(residuals: Array, floor: Array) -> float:
    """Negative log likelihood [nats] of residuals (N, nv, C) whose channels scatter each by as much as they do."""
    variance = calm(residuals**2).mean(0) + floor**2
    return 0.5 * len(residuals) * float(np.log(variance).sum())


class Gathering:
    """Samples of free parameters, what they leave over, and the best of them.

    Args:
        fitter: Of the windows.
        replay: What is simulated.
        chart: Coordinates of its free parameters.
        floor: Smallest residual believed (nv, C).
        start: Free parameters to start from (D,).
        free: Which of them move (k,).

    Attributes:
        best: free parameters of the best sample (D,).
        cost: its cost [nats], see `spread`.
    """

    def __init__(
        self, fitter: Fitter, replay: Replay, chart: Chart, floor: Array, start: Array, free: NDArray[np.intp]
    ) -> None:
        self._fitter, self._replay, self._chart, self._floor, self._free = fitter, replay, chart, floor, free
        self._at: list[Array] = []
        self._residuals: list[Array] = []
        self._cost: list[float] = []
        self._add(chart.inward(start)[None])

    @property
    def best(self) -> Array:
        """Free parameters of the best sample (D,)."""
        return self._chart.outward(self._at[self._leader])

    @property
    def cost(self) -> float:
        """Cost of the best sample [nats]."""
        return self._cost[self._leader]

    @property
    def _leader(self) -> int:
        return int(np.argmin(self._cost))

    def rounds(self, count: int, widths: Array, rng: np.random.Generator) -> None:
        """Sample about the best, and where the linear model says, ever closer.

        Args:
            count: Rounds.
            widths: Distances of the first round, in coordinates (k,).
            rng: Turns the directions.
        """
        k = len(self._free)
        for _ in range(count):
            turned = np.linalg.qr(rng.normal(size=(k, k)))[0] * np.sqrt(k)
            # few parameters: both sides of each direction; many: one side, the model keeps what it saw before
            away = np.concatenate([turned, -turned]) if k <= 2 else turned
            self._beside(widths * away)
            self._beside(np.array([self._step(widths, damping) for damping in _DAMPINGS]))
            self._beside(self._step(widths, _DAMPINGS[0])[None])
            widths = _CLOSER * widths

    def _beside(self, moves: Array) -> None:
        """Sample at moves (S, k) from the best."""
        at = np.tile(self._at[self._leader], (len(moves), 1))
        at[:, self._free] += moves
        self._add(np.clip(at, self._chart.low, self._chart.high))

    def _add(self, at: Array) -> None:
        residuals = self._fitter.residuals_at(self._replay, self._chart.outward(at))
        self._at.extend(at)
        self._residuals.extend(residuals)
        self._cost.extend(spread(r, self._floor) for r in residuals)

    def _step(self, widths: Array, damping: float) -> Array:
        """From the best to where the linear model of the samples about it is least (k,)."""
        leader, k = self._leader, len(self._free)
        apart = (np.array(self._at) - self._at[leader])[:, self._free] / widths
        distance = np.linalg.norm(apart, axis=1) / np.sqrt(k)
        near = np.argsort(distance, kind="stable")[: 4 * k + 4]
        near = near[distance[near] <= _REACH]
        own = self._residuals[leader]
        scale = np.sqrt(calm(own**2).mean(0) + self._floor**2)
        there = np.array([self._residuals[i] for i in near]) / scale
        sound = np.isfinite(there).all(0)
        trust = np.where(sound, 1.0 / (1.0 + (np.where(sound, own / scale, 0.0) / _TAIL) ** 2), 0.0).ravel()
        columns = np.hstack([np.ones((len(near), 1)), apart[near]])
        weighted = columns / (1.0 + distance[near, None] ** 2)
        ridge = 1e-6 * np.eye(k + 1)
        model = np.linalg.solve(
            weighted.T @ columns + ridge, weighted.T @ np.where(sound, there, 0.0).reshape(len(near), -1)
        )
        middle, slopes = model[0], model[1:]
        matrix = (slopes * trust) @ slopes.T
        matrix += (1e-6 * np.trace(matrix) / k + 1e-300) * np.eye(k) + damping * np.diag(np.diag(matrix))
        step = -np.linalg.solve(matrix, (slopes * trust) @ middle)
        return widths * step * min(1.0, _REACH / max(float(np.abs(step).max()), 1e-300))
