"""Windows that follow each other share a measured state: covariances that are block tridiagonal, one block a window.

A window starts from a measured state, whose error e is propagated by the derivative G of its end by its start, and ends
at measured states with errors of their own: its residual is r_t = G_t e_t - e_(t+1) + w_t, with w_t what the simulation
itself lacks. The next window starts from the state with error e_(t+1). All that is needed of such a covariance (its
factor, solutions with it, the blocks of its inverse next to the diagonal) comes from one pass forward and one back, as
in Kalman's filter and its smoother, with a cost linear in the number of windows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

ROUNDING = 1e-13
"""Share of a variance that is rounding: what a large error of one channel makes of others is not known any better, and
a covariance of sums that are known to more digits is singular in double precision."""


@dataclass(frozen=True, eq=False)
class Chains:
    """N windows in chains; all chains advance together, the longest first.

    steps: the t-th window of every chain that has one; its predecessors are the first of `steps[t - 1]`
    linked: whether a window starts from the state at which another one ends      (N,)
    followed: whether another window starts from the state at which it ends       (N,)
    """

    steps: list[Index]
    linked: NDArray[np.bool_]
    followed: NDArray[np.bool_]

    @classmethod
    def of(cls, linked: NDArray[np.bool_]) -> Chains:
        """From windows in order, each either linked to the one before it or the first of a chain."""
        first = np.flatnonzero(~linked)
        lengths = np.diff([*first.tolist(), len(linked)])
        order = np.argsort(-lengths, kind="stable")
        first, lengths = first[order], lengths[order]
        steps = [first[lengths > t] + t for t in range(int(lengths[0]) if len(lengths) else 0)]
        return cls(steps, linked, np.append(linked[1:], False))


@dataclass(frozen=True, eq=False)
class Factor:
    """The covariance of all windows as (1 + K) S (1 + K)', K strictly lower and S block diagonal.

    spread: S, what earlier windows leave unknown of each                  (N, C, C)
    inverse: of S                                                          (N, C, C)
    gain: K, what a window's innovation tells of the next residual; zero at the start of a chain    (N, C, C)
    """

    chains: Chains
    spread: Array
    inverse: Array
    gain: Array

    @classmethod
    def of(cls, chains: Chains, own: Array, shared: Array, weights: Array) -> Factor:
        """Factorise.

        Args:
            chains: which window follows which.
            own: covariance of every window                                (N, C, C)
            shared: covariance of a window with the last state of the one before it; not read at the start of a
                chain                                                      (N, C, ndiff)
            weights: what a window counts: S / weight is its covariance, and nothing is told by a window of weight
                zero                                                       (N,)
        """
        last = slice(own.shape[1] - shared.shape[2], None)
        spread, inverse, gain = own.copy(), np.empty_like(own), np.zeros_like(own)
        before: Index = np.empty(0, np.intp)
        for t, now in enumerate(chains.steps):
            s = own[now]
            if t:
                before = before[: len(now)]
                k = shared[now] @ inverse[before, last] * weights[before, None, None]
                s = s - k[:, :, last] @ shared[now].swapaxes(1, 2)
                gain[now] = k
            s = 0.5 * (s + s.swapaxes(1, 2)) + ROUNDING * s * np.eye(s.shape[1])
            spread[now], inverse[now] = s, np.linalg.inv(s)
            before = now
        return cls(chains, spread, inverse, gain)

    def innovations(self, residuals: Array) -> Array:
        """What earlier windows do not tell of each residual, (N, C) to (N, C); of columns, (N, C, K), of each."""
        found = residuals.copy()
        before: Index = np.empty(0, np.intp)
        for t, now in enumerate(self.chains.steps):
            if t:
                found[now] -= _times(self.gain[now], found[before[: len(now)]])
            before = now
        return found

    def solution(self, innovations: Array, weights: Array) -> Array:
        """Solution x of covariance x = r, (N, C); of columns, (N, C, K).

        Args:
            innovations: of residuals r, (N, C), or of columns, (N, C, K).
            weights: of the windows, (N,).
        """
        solution = _times(weights[:, None, None] * self.inverse, innovations)
        for before, after in self._back():
            solution[before] -= _times(self.gain[after].swapaxes(1, 2), solution[after])
        return solution

    def inverse_blocks(self, weights: Array) -> tuple[Array, Array]:
        """Diagonal blocks of the inverse covariance (N, C, C), and its blocks of each window with the one before.

        These (N, C, C) are zero at the start of a chain; weights (N,) are those of the windows.
        """
        diagonal = weights[:, None, None] * self.inverse
        below = np.zeros_like(diagonal)
        for before, after in self._back():
            k = self.gain[after]
            cross = -diagonal[after] @ k
            diagonal[before] -= k.swapaxes(1, 2) @ cross
            below[after] = cross
        return diagonal, below

    def _back(self) -> Iterator[tuple[Index, Index]]:
        """Windows that are followed and those that follow them, the last of the chains first."""
        steps = self.chains.steps
        for now, after in zip(steps[-2::-1], steps[:0:-1], strict=True):
            yield now[: len(after)], after


def _times(matrices: Array, x: Array) -> Array:
    """Matrices (n, C, C) times one vector each (n, C), or times columns (n, C, K)."""
    return matrices @ x if x.ndim == 3 else np.einsum("nij,nj->ni", matrices, x)
