"""Exact optimal transport between weighted point sets; every answer carries the proof that it is optimal.

The transport problem moves the masses `a` of the points `x` onto the masses `b` of the points `y` at least cost:

    min over plans P >= 0 of sum_ij P[i, j] c(x[i], y[j]),    rows of P sum to a, columns to b.

Its dual is max sum_i a[i] alpha[i] + sum_j b[j] beta[j] with alpha[i] + beta[j] <= c(x[i], y[j]) for every pair.
A plan whose cost equals the value of such potentials is optimal. The solver finds both, checks them in double
precision over all pairs (on a line along the plan, where the order of the points settles all other pairs), and raises
`NotOptimal` rather than return a number it cannot prove.
Costs far beyond those that an optimal plan can pay, found by any plan, are clipped where potentials of their size
would lose the digits that decide; potentials for the clipped costs prove the plan for the true ones.

Reference: G. Peyre and M. Cuturi, Computational Optimal Transport, 2019, chapters 2 and 3.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from nfpde import _rust_ot
from nfpde.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

__all__ = ["EmdResult", "Metric", "Plan", "emd", "emd_matrix", "wasserstein"]

Metric = Literal["euclidean", "sqeuclidean", "cityblock"]
_METRICS = ("euclidean", "sqeuclidean", "cityblock")

#: What coordinates lose where others are far away is nothing beside a cost above this one.
_BLURRED = 1e-270

#: Whole numbers below this one are floats.
_LARGEST_WHOLE = 2.0**53


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """The arcs of a transport plan that carry mass, at most n + m - 1, sorted by row, then column.

    Attributes:
        rows: Index into x of each arc, (k,).
        cols: Index into y of each arc, (k,).
        mass: Mass on each arc, (k,), in the unit of the weights.
        shape: (n, m).
    """

    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    mass: Floats
    shape: tuple[int, int]

    def toarray(self) -> Floats:
        """The plan as a full matrix, (n, m)."""
        full = np.zeros(self.shape)
        full[self.rows, self.cols] = self.mass
        return full


@dataclass(frozen=True, eq=False, slots=True)
class EmdResult:
    """An optimal plan with its proof.

    Attributes:
        cost: Total cost of the plan: sum of mass times cost.
        plan: The plan.
        potentials: alpha (n,) and beta (m,), with alpha[i] + beta[j] <= cost[i, j] for every pair up to rounding.
        gap: cost - (a @ alpha + b @ beta), summed from its parts without cancellation: how far at most the cost is
            above the optimum. At most 1e-12 of the cost; where the dual value is made of far larger numbers, at most
            eight units in the last place of those, weighted with their masses. That may be 1e-6 of the cost (counted
            without signs), or eight units in the last place of the total mass times the largest cost that the plan
            pays: so little cost clouds that coincide but for the rounding of their weights. What is more is an error,
            except on a line, where the order of the points proves the plan.
            The optimum is that of the weights to their last bit, those of y taken as shares of the total of x's, so
            that a light point has the mass of its own weight, down to 1e-60 of the total. Whether a difference of
            1e-16 between the sums of heavy weights is meant only the caller can know.
    """

    cost: float
    plan: Plan
    potentials: tuple[Floats, Floats]
    gap: float


def emd(
    x: ArrayLike,
    y: ArrayLike,
    a: ArrayLike | None = None,
    b: ArrayLike | None = None,
    metric: Metric = "euclidean",
    *,
    threads: int = 1,
) -> EmdResult:
    """Solves the transport problem between two point sets (the earth mover's distance).

    Masses that are not given are equal, with the total of the other side, or 1 when neither is given.

    Args:
        x: Points of the first set, (n, d), any real numbers; arrays and CPU tensors are taken as they are.
        y: Points of the second set, (m, d).
        a: Masses of x, (n,), not negative; None for equal masses.
        b: Masses of y, (m,), with the total of a (to 1e-9 relative); None for equal masses.
        metric: Cost of a pair: "euclidean", "sqeuclidean" (its square) or "cityblock". No root is taken.
        threads: Threads that share the passes over all pairs; the answer has the same bits for any number.

    Returns:
        The optimal cost and plan, and the potentials that prove it.

    Raises:
        BadInput: An argument breaks one of these rules; the text names the index at fault.
        NotOptimal: No plan could be proven as `EmdResult.gap` promises, also with more care; the text says what to do.

    Example:
        >>> result = emd([[0.0], [1.0]], [[2.0], [4.0]])
        >>> result.cost, result.plan.cols.tolist()
        (2.5, [0, 1])
    """
    if metric not in _METRICS:
        raise BadInput(f"metric is {metric!r}: choose one of {', '.join(_METRICS)}")
    points_x, points_y = _points(x, y)
    solve = partial(_rust_ot.solve_points, points_x, points_y, metric=metric)
    return _result((len(points_x), len(points_y)), partial(solve, threads=_threads(threads)), a, b)


def emd_matrix(
    cost: ArrayLike, a: ArrayLike | None = None, b: ArrayLike | None = None, *, threads: int = 1
) -> EmdResult:
    """Solves the transport problem for a given cost matrix.

    Args:
        cost: Cost of each pair, (n, m), finite; negative costs are allowed. Not copied: no other thread may change
            it meanwhile.
        a: Masses of the rows, (n,), not negative; None for equal masses.
        b: Masses of the columns, (m,), with the total of a (to 1e-9 relative); None for equal masses.
        threads: Threads that share the passes over all pairs; the answer has the same bits for any number.

    Returns:
        The optimal cost and plan, and the potentials that prove it.

    Raises:
        BadInput: An argument breaks one of these rules; the text names the index at fault.
        NotOptimal: No plan could be proven as `EmdResult.gap` promises, also with more care; the text says what to do.

    Example:
        >>> emd_matrix([[0.0, 1.0], [1.0, 0.0]], [0.75, 0.25], [0.5, 0.5]).cost
        0.25
    """
    costs = _matrix("cost", cost, "(rows, columns)")
    solve = partial(_rust_ot.solve_matrix, costs, threads=_threads(threads))
    return _result((len(costs), costs.shape[1]), solve, a, b)


def wasserstein(
    x: ArrayLike,
    y: ArrayLike,
    p: float = 1,
    a: ArrayLike | None = None,
    b: ArrayLike | None = None,
    *,
    threads: int = 1,
) -> float:
    """The p-Wasserstein distance (sum_ij P[i, j] |x[i] - y[j]|^p)^(1/p) of the optimal plan; the root is taken.

    Args:
        x: Points of the first set, (n, d), any floats; |.| is the Euclidean length.
        y: Points of the second set, (m, d).
        p: Order, at least 1 and finite. Orders other than 1 and 2 keep the costs of all pairs, 8 n m bytes, unless the
            points lie on a line along an axis.
        a: Weights of x, (n,), not negative; None for equal weights. Weights are divided by their total.
        b: Weights of y, (m,), with the total of a (to 1e-9 relative); None for equal weights.
        threads: Threads that share the passes over all pairs; the answer has the same bits for any number.

    Returns:
        The distance, in the unit of the coordinates.

    Raises:
        BadInput: An argument breaks one of these rules; the text names the index at fault.
        NotOptimal: No plan could be proven as `EmdResult.gap` promises, also with more care.

    Example:
        >>> wasserstein([[0.0, 0.0]], [[3.0, 4.0]], p=2)
        5.0
    """
    order = float(p) if isinstance(p, np.integer | np.floating) else p
    if isinstance(p, bool) or not isinstance(order, int | float) or not 1 <= order <= sys.float_info.max:
        raise BadInput(f"p is {p!r}: the order of a Wasserstein distance is a finite number, at least 1")
    p = float(order)
    points_x, points_y = _points(x, y)
    weights_a, weights_b = _vector("a", a), _vector("b", b)
    points_x, points_y = _apart(points_x, points_y)
    unit = _unit(points_x, points_y)
    given_x, given_y = points_x, points_y
    points_x, points_y = points_x / unit, points_y / unit
    blurred = not (np.array_equal(points_x * unit, given_x) and np.array_equal(points_y * unit, given_y))
    if p in (1, 2):
        metric = "euclidean" if p == 1 else "sqeuclidean"
        result = emd(points_x, points_y, weights_a, weights_b, metric, threads=threads)
    elif points_x.shape[1] == 1:
        solve = partial(_rust_ot.solve_numbers, points_x[:, 0], points_y[:, 0], order=p)
        result = _result((len(points_x), len(points_y)), solve, weights_a, weights_b)
    else:
        result = emd_matrix(_powers(points_x, points_y, p), weights_a, weights_b, threads=threads)
    moved = not np.array_equal(given_x[result.plan.rows], given_y[result.plan.cols])
    if blurred and moved and result.cost < _BLURRED:
        raise BadInput("the distance lies outside the range of numbers beside points that are so far: leave those out")
    if result.cost == 0 and moved:
        raise BadInput(f"p is {p:g}: at this order the costs of the plan vanish in double precision; lower p")
    return _within_range((result.cost / _total(weights_a, weights_b)) ** (1 / p) * unit, zero=not moved)


def _points(x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Two checked point sets of one dimension."""
    points_x, points_y = _matrix("x", x), _matrix("y", y)
    if points_x.shape[1] != points_y.shape[1]:
        raise BadInput(
            f"x has {points_x.shape[1]} coordinates a point and y has {points_y.shape[1]}: they must be equal"
        )
    return points_x, points_y


def _matrix(name: str, values: ArrayLike, axes: str = "(points, coordinates)") -> Floats:
    """A checked C-contiguous float64 matrix; no copy where it already is one."""
    array = _floats(name, values)
    if array.ndim != 2:
        raise BadInput(f"{name} has shape {array.shape}: it must have 2 dimensions, {axes}")
    if 0 in array.shape:
        raise BadInput(f"{name} has shape {array.shape}: it is empty; give at least one row and one column")
    return array


def _vector(name: str, values: ArrayLike | None) -> Floats | None:
    """Checked C-contiguous float64 weights; what they hold is checked by the solver."""
    if values is None:
        return None
    array = _floats(name, values)
    if array.ndim != 1:
        raise BadInput(f"{name} has shape {array.shape}: weights have 1 dimension, one weight a point")
    return array


def _floats(name: str, values: ArrayLike) -> Floats:
    """A C-contiguous float64 array of real numbers."""
    parts = values if isinstance(values, list | tuple) else [values]
    if any(np.ma.is_masked(part) for part in parts):  # what lies under a mask would count
        raise BadInput(f"{name} is masked in part: leave its masked rows out, with their weights")
    try:
        array = np.asarray(values)
    except (TypeError, ValueError, RuntimeError) as error:
        raise BadInput(f"{name} cannot be read as an array on the CPU: {error}") from error
    if array.dtype.kind not in "fiub":
        raise BadInput(f"{name} has dtype {array.dtype}: it must hold real numbers")
    floats = np.ascontiguousarray(array, dtype=np.float64)
    if array.dtype.kind in "iu":
        _check_whole(name, array, floats)
    return floats


def _check_whole(name: str, given: NDArray[np.generic], floats: Floats) -> None:
    """Refuses whole numbers that float64 does not hold: rounded, points that differ would be one."""
    large = np.argwhere(np.abs(floats) >= _LARGEST_WHOLE)
    place = next((tuple(at) for at in large.tolist() if int(given[tuple(at)]) != int(floats[tuple(at)])), None)
    if place is not None:
        raise BadInput(
            f"{name}{list(place)} is {given[place]}: float64 does not hold this whole number; subtract an offset "
            "from all of them, or give floats that may be rounded"
        )


def _threads(threads: int) -> int:
    """A checked number of threads."""
    if isinstance(threads, bool) or not isinstance(threads, int | np.integer) or not 1 <= threads <= 1024:
        raise BadInput(f"threads is {threads!r}: give a whole number from 1 to 1024")
    return int(threads)


def _within_range(distance: float, *, zero: bool) -> float:
    """A distance that float64 holds; `zero` says whether it may be none."""
    if not math.isfinite(distance) or (distance == 0 and not zero):
        raise BadInput("the distance lies outside the range of numbers: rescale the points")
    return distance


def _total(a: Floats | None, b: Floats | None) -> float:
    """The total mass that the solver moved."""
    given = a if a is not None else b
    return 1.0 if given is None else math.fsum(given)


def _apart(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The points in the coordinates in which they differ, at least one: others play no part, however large they are."""
    for name, points in (("x", x), ("y", y)):
        if not np.isfinite(points).all():
            row, column = np.argwhere(~np.isfinite(points))[0]
            raise BadInput(f"{name}[{row}, {column}] is {points[row, column]}: coordinates must be finite")
    apart = np.minimum(x.min(axis=0), y.min(axis=0)) < np.maximum(x.max(axis=0), y.max(axis=0))
    if apart.all():
        return x, y
    if not apart.any():
        return np.zeros((len(x), 1)), np.zeros((len(y), 1))
    return np.ascontiguousarray(x[:, apart]), np.ascontiguousarray(y[:, apart])


def _unit(x: Floats, y: Floats) -> float:
    """A power of two just above the largest distance, to divide by without rounding."""
    high, low = np.maximum(x.max(axis=0), y.max(axis=0)), np.minimum(x.min(axis=0), y.min(axis=0))
    # Halves, because a width may be beyond the range of numbers; but not those of widths at its lower end.
    half = float((high / 2 - low / 2).max())
    if half < sys.float_info.min:
        half = float((high - low).max())
    exponent = math.frexp(half)[1] + 1 + math.ceil(math.log2(x.shape[1]) / 2)
    return 2.0 ** min(max(exponent, -1021), 1023) if half > 0 else 1.0


def _powers(x: Floats, y: Floats, p: float) -> Floats:
    """|x[i] - y[j]|^p for every pair, (n, m), from direct differences."""
    costs = np.empty((len(x), len(y)))
    for out, point in zip(costs, x, strict=True):
        np.power(np.linalg.norm(point - y, axis=1), p, out=out)
    return costs


def _result(
    shape: tuple[int, int],
    solve: Callable[..., tuple[float, NDArray[np.int64], NDArray[np.int64], Floats, Floats, Floats, float]],
    a: ArrayLike | None,
    b: ArrayLike | None,
) -> EmdResult:
    """Solves for checked weights and names the parts of the answer."""
    cost, rows, cols, mass, alpha, beta, gap = solve(a=_vector("a", a), b=_vector("b", b))
    return EmdResult(cost, Plan(rows, cols, mass, shape), (alpha, beta), gap)
