"""Degrees of freedom: what the fit has used up of the residuals, and what is left of them to tell the noise.

Parameters are fitted by the channels that tell them, and take the freedom of those. The noise that is learned from what
is left is itself known to so many degrees of freedom, and what it says of the parameters is no more certain than that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from nfpde.estimation.trajectory.chains import Factor

Array = NDArray[np.float64]
Index = NDArray[np.intp]

ENDS = 0.95
"""Quantile at which intervals end, where a Gaussian of `widening` is as wide as Student's t."""

FEWEST = 1.0
"""Degrees of freedom without which nothing is known of the noise: a variance of one number has one."""

MOST_USED = 0.99
"""Share of the residuals that a fit can have used up: what rounding leaves of less says nothing."""

ROUNDING = 1e-12
"""Share of a parameter's information that is rounding: what tells a sum to 1e-10 says that much of the split."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """What was fitted to the residuals of N windows.

    slopes: derivative of the residuals by the parameters of their robot; zero where a window diverged    (N, C, D)
    robot: whose each window is                                            (N,)
    prior: what the bounds say of each robot's parameters                  (G, D, D)
    share: how many of each robot's windows are among the N                (G,)
    """

    slopes: Array
    robot: Index
    prior: Array
    share: Array

    @classmethod
    def of(cls, slopes: Sequence[Array], prior: Array) -> Fitted:
        """Of all windows, robot after robot: slopes G arrays (D, n_g, C), prior (G, D, D)."""
        rows = np.concatenate([s.transpose(1, 2, 0) for s in slopes])
        robot = np.repeat(np.arange(len(slopes)), [s.shape[1] for s in slopes])
        # as many numbers of a window that diverged as there are have no say
        sound: NDArray[np.bool_] = np.asarray(np.isfinite(rows).all((1, 2)))
        return cls(np.where(sound[:, None, None], rows, 0.0), robot, prior, np.ones(len(slopes)))

    @classmethod
    def nothing(cls, windows: int, channels: int) -> Fitted:
        """Residuals of a simulation without parameters."""
        return cls(np.zeros((windows, channels, 0)), np.zeros(windows, np.intp), np.zeros((1, 0, 0)), np.ones(1))

    def some(self, kept: Index) -> Fitted:
        """The same of the windows `kept` alone."""
        before, after = (np.bincount(r, minlength=len(self.prior)) for r in (self.robot, self.robot[kept]))
        share = self.share * after / np.maximum(before, 1)
        return replace(self, slopes=self.slopes[kept], robot=self.robot[kept], share=share)

    def used(self, factor: Factor, weights: Array, scale: float) -> Used:
        """What the fit uses up of the residuals, whose covariance is `scale` times that of `factor`.

        Args:
            factor: of the covariance.
            weights: of the windows, (N,).
            scale: of the covariance.
        """
        x = self.slopes
        solved = factor.solution(factor.innovations(x), weights)
        robots, d = self.prior.shape[:2]
        products = np.matmul(x.swapaxes(1, 2), solved)
        information = np.zeros((robots, d, d))
        np.add.at(information, self.robot, 0.5 * (products + products.swapaxes(1, 2)) / scale)
        # of windows that are left out a robot knows as much as of those that are not
        information = information / np.where(self.share > 0, self.share, 1.0)[:, None, None]
        own = np.einsum("gdd->gd", information)
        held = self.prior + np.eye(d) * (ROUNDING * own)[:, :, None]
        lower = np.linalg.inv(np.linalg.cholesky(held))
        gains, axes = np.linalg.eigh(lower @ information @ lower.swapaxes(1, 2))
        gains = np.maximum(gains, 0.0)
        root = lower.swapaxes(1, 2) @ axes / np.sqrt(1 + gains)[:, None]
        log_det = float((self.share * (np.linalg.slogdet(held)[1] + np.log1p(gains).sum(1))).sum())
        total = float((self.share * (gains / (1 + gains)).sum(1)).sum())
        return Used(solved @ root[self.robot] / np.sqrt(scale), self.robot, total, log_det, scale)


@dataclass(frozen=True, eq=False)
class Used:
    """What a fit has used up of the residuals.

    columns: what residuals like those that the fit has taken away have for solution: one for each direction in the
        parameters of a robot, independent of the others. Their squares are what the squares of the residuals' own
        solution lack                                                      (N, C, D)
    robot: whose each window is                                            (N,)
    total: degrees of freedom in all: a direction that the bounds alone hold uses none
    log_det: log determinant of what is known of the parameters, as in the restricted likelihood [nats]
    scale: of the covariance
    """

    columns: Array
    robot: Index
    total: float
    log_det: float
    scale: float


def widening(degrees: float) -> float:
    """Factor on a variance that is known to so many degrees of freedom, as large as Student's t asks for.

    A Gaussian with it has the intervals of Student's t that are reported, those that hold nine tenths; of a variance
    that is known for sure it is one.
    """
    return float((student.ppf(ENDS, max(degrees, FEWEST)) / norm.ppf(ENDS)) ** 2)
