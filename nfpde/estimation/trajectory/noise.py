"""The distribution of the residuals: errors of the measured states, and what the simulation itself lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from nfpde.estimation.trajectory.chains import Chains, Factor
from nfpde.estimation.trajectory.freedom import widening
from nfpde.estimation.trajectory.student import GAUSSIAN, standard_constant
from nfpde.sim import Whitening

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Scatter:
    """What all windows share: sizes of the errors, in the units of the problem.

    sensor: variance of the error of a measured state; empty while none is told from the rest    (ndiff,)
    process: covariance of what a window's simulation lacks                (C, C)
    degrees: degrees of freedom of the innovations; `GAUSSIAN` is a Gaussian
    scale: of the innovations' covariance
    freedom: degrees of freedom to which all this is known, see `degrees_left`
    """

    sensor: Array
    process: Array
    degrees: float = GAUSSIAN
    scale: float = 1.0
    freedom: float = np.inf

    @classmethod
    def white(cls, channels: int) -> Scatter:
        """Before anything is known: every channel of a residual has variance one."""
        return cls(np.zeros(0), np.eye(channels))

    def weight(self, squares: Array) -> Array:
        """What a window counts in least squares: one in a Gaussian, little far out in the tails."""
        return (self.degrees + len(self.process)) / (self.degrees + squares)

    @property
    def told(self) -> float:
        """Share of the weighted least squares' information that a window tells: one in a Gaussian, less with tails.

        Fisher's information of a Student t over that of its core, whose weights average one (Lange, Little, Taylor
        1989).
        """
        return (self.degrees + len(self.process)) / (self.degrees + len(self.process) + 2)

    @property
    def believed(self) -> float:
        """Scale of the innovations' covariance that residuals are weighed with: wider where few tell it."""
        return self.scale * widening(self.freedom)

    @property
    def spread(self) -> float:
        """Standard deviation of a channel over the root of its scale: one in a Gaussian, more with tails."""
        return float(np.sqrt(self.degrees / (self.degrees - 2)))

    def gain_weight(self, squares: Array) -> Array:
        """What windows tell of the next ones, by the squares of their innovations (N,), not yet over the scale.

        All of it, but for those that are larger than the largest of N Gaussian ones is in a hundred recordings: they
        are something else than an error of the state between the two. One that diverged (NaN) tells nothing.
        """
        m = squares / self.scale
        usual = chi2.isf(0.01 / max(len(m), 1), len(self.process))
        return np.where(np.isfinite(m), np.where(m <= usual, 1.0, self.weight(m)), 0.0)

    def covariances(self, slopes: Array) -> tuple[Array, Array]:
        """Covariance of every window (N, C, C), and of it with its start's error, negative: (N, C, ndiff).

        Args:
            slopes: derivative G of a window's end by its start            (N, C, ndiff)
        """
        spread = slopes * self.sensor
        channels, ndiff = slopes.shape[1:]
        ends = np.diag(np.tile(self.sensor, channels // ndiff))
        return spread @ slopes.swapaxes(1, 2) + ends + self.process, -spread


@dataclass(frozen=True, eq=False)
class Noise:
    """The residuals given a parameter vector: innovations that are multivariate Student t, one a window.

    Reference: Lange, Little, Taylor, Robust statistical modeling using the t distribution, JASA 1989, for the tails;
    the innovations are those of Kalman's filter for the errors of the measured states.

    scatter: what all windows share
    whitening: what turns residuals into white innovations
    members: indices of each robot's windows                               G arrays
    """

    scatter: Scatter
    whitening: Whitening
    members: Sequence[Index]

    @classmethod
    def alike(cls, scatter: Scatter, members: Sequence[Index]) -> Noise:
        """All windows alike and independent: errors of the states counted as the simulation's."""
        white = np.asarray(np.linalg.inv(np.linalg.cholesky(scatter.believed * scatter.process)), np.float64)[None]
        alone = np.zeros(sum(len(m) for m in members), bool)
        return cls(scatter, Whitening(white, np.zeros(white.shape), alone, scatter.degrees), members)

    @classmethod
    def of(cls, scatter: Scatter, slopes: Array, chains: Chains, weights: Array, members: Sequence[Index]) -> Noise:
        """Windows that share the errors of the states between them.

        Args:
            scatter: what all windows share.
            slopes: derivative of every window's end by its start          (N, C, ndiff)
            chains: which window follows which.
            weights: what a window tells of the next one                   (N,)
            members: indices of each robot's windows                       G arrays
        """
        factor = Factor.of(chains, *scatter.covariances(slopes), weights)
        lower = np.linalg.cholesky(scatter.believed * factor.spread)
        own = np.asarray(np.linalg.inv(lower), np.float64)
        carry = np.zeros(own.shape)
        after = np.flatnonzero(chains.linked)
        carry[after] = own[after] @ factor.gain[after] @ lower[after - 1]
        return cls(scatter, Whitening(own, carry, chains.linked, scatter.degrees), members)

    @property
    def log_scale(self) -> float:
        """Half the log determinant of an innovation's covariance per channel: the log of a typical residual."""
        logs = np.linalg.slogdet(self.whitening.own)[1]
        # it is believed to be larger where few windows tell it
        return -float(logs.mean()) / self.whitening.channels - 0.5 * float(np.log(widening(self.scatter.freedom)))

    @property
    def log_constant(self) -> float:
        """The part of the log likelihood of all windows that does not depend on their residuals [nats]."""
        w = self.whitening
        logs = np.linalg.slogdet(w.own)[1] + standard_constant(w.degrees, w.channels)
        return float(np.broadcast_to(logs, len(w.linked)).sum())

    @property
    def alone(self) -> Array:
        """W (C, C) with W W' the mean information about an innovation: what a moment's slopes count on average."""
        own = self.whitening.own
        return np.linalg.cholesky(self.scatter.told * np.einsum("nki,nkj->ij", own, own) / len(own))

    def whiten(self, robot: int, residuals: Array) -> Array:
        """White innovations of a robot's residuals, or of their slopes: (..., n, C) to (..., n, C)."""
        return self.whitening.along(self.members[robot], residuals)

    def totals(self, robots: Index, residuals: Sequence[Array]) -> Array:
        """Twice the negative log likelihood, up to a constant, of recordings of robots[k]: K arrays (n_k, C) to (K,).

        A window that diverged (NaN) costs what no other does.
        """
        found = np.empty(len(residuals))
        for g in np.unique(robots):
            own = np.flatnonzero(robots == g).tolist()
            white = self.whiten(int(g), np.stack([residuals[k] for k in own]))
            found[own] = self.whitening.cost(white).sum(1)
        return found
