"""Point sets, weights and the brute-force certificate shared by the tests of nfpde.ot."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from scipy.spatial.distance import cdist

from nfpde.ot import EmdResult

#: Rounding of sums and of potentials along a tree: some hundred operations on numbers of the cost's size.
ROUNDING = 1e-12


def clouds(kind: str, n: int, m: int, d: int, seed: int = 0):
    """Two point sets, (n, d) and (m, d)."""
    rng = np.random.default_rng(seed)
    if kind == "gauss":
        return rng.normal(size=(n, d)), 0.5 + 1.2 * rng.normal(size=(m, d))
    if kind == "lattice":
        return rng.integers(0, 3, (n, d)).astype(float), rng.integers(0, 3, (m, d)).astype(float)
    if kind == "duplicates":
        return np.repeat(rng.normal(size=(-(-n // 10), d)), 10, axis=0)[:n], rng.normal(size=(m, d))
    if kind == "far":
        return rng.normal(size=(n, d)), 50 + rng.normal(size=(m, d))
    centres, shift, spread = 3 * rng.normal(size=(5, d)), 0.3 * rng.normal(size=(5, d)), 0.5 + rng.random(5)
    z, w = rng.integers(0, 5, n), rng.integers(0, 5, m)
    x = centres[z] + spread[z, None] * rng.normal(size=(n, d))
    return x, centres[w] + shift[w] + spread[w, None] * rng.normal(size=(m, d))


def masses(kind: str, n: int, m: int, seed: int = 1):
    """Two weight vectors of total 1."""
    if kind == "uniform":
        return np.full(n, 1 / n), np.full(m, 1 / m)
    rng = np.random.default_rng(seed)
    power = 6 if kind == "skewed" else 1
    a, b = rng.exponential(size=n) ** power, rng.exponential(size=m) ** power
    return a / a.sum(), b / b.sum()


def check_certificate(result: EmdResult, cost: np.ndarray, a: np.ndarray, b: np.ndarray) -> None:
    """Checks by brute force that the plan is feasible and that the potentials prove it optimal."""
    n, m = cost.shape
    plan, (alpha, beta) = result.plan, result.potentials
    size = np.abs(cost).max() + np.abs(alpha).max() + np.abs(beta).max()
    slack = cost - alpha[:, None] - beta[None, :]
    assert slack.min() >= -ROUNDING * size, "potentials exceed a cost"
    assert np.abs(slack[plan.rows, plan.cols]).max() <= ROUNDING * size, "mass on an arc with slack"
    assert (plan.mass > 0).all()
    assert len(plan.mass) <= n + m - 1
    assert len(set(zip(plan.rows.tolist(), plan.cols.tolist(), strict=True))) == len(plan.mass)
    total = a.sum()
    np.testing.assert_allclose(np.bincount(plan.rows, plan.mass, n), a, rtol=1e-13, atol=1e-15 * total)
    np.testing.assert_allclose(np.bincount(plan.cols, plan.mass, m), b, rtol=1e-13, atol=1e-15 * total)
    assert abs(plan.mass @ cost[plan.rows, plan.cols] - result.cost) <= ROUNDING * size * total
    assert abs(a @ alpha + b @ beta - result.cost) <= ROUNDING * size * total
    assert abs(result.gap) <= ROUNDING * size * total


def distances(x: np.ndarray, y: np.ndarray, metric: str = "euclidean") -> np.ndarray:
    """The cost matrix, (n, m), from direct differences."""
    return cdist(x, y, metric)  # type: ignore[call-overload]


def least_size(alpha: np.ndarray, beta: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """What the dual value is made of: sum of a |alpha| + b |beta|, counted from where that is least."""
    places, weights = np.concatenate([alpha, -beta]), np.concatenate([a, b])
    order = np.argsort(places)
    half = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    median = places[order[min(half, len(order) - 1)]]
    return float(weights @ np.abs(places - median))


def unproven(result: EmdResult, cost: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[Fraction, Fraction]:
    """Cost above the value of the potentials: as they are, and lowered on one side until they fit every pair."""
    left, right = [Fraction(w) for w in a], [Fraction(w) for w in b]
    right = [w * sum(left) / sum(right) for w in right]  # the columns' weights are shares of the rows' total
    alpha, beta = ([Fraction(p) for p in side] for side in result.potentials)
    exact = [[Fraction(c) for c in row] for row in cost]
    lower_alpha = [min(c - v for c, v in zip(row, beta, strict=True)) for row in exact]
    lower_beta = [min(row[j] - u for row, u in zip(exact, alpha, strict=True)) for j in range(len(beta))]

    def value(u: list[Fraction], v: list[Fraction]) -> Fraction:
        return sum((w * p for w, p in zip(left + right, u + v, strict=True)), Fraction(0))

    bound = max(value(lower_alpha, beta), value(alpha, lower_beta))
    return Fraction(result.cost) - value(alpha, beta), Fraction(result.cost) - bound
