"""nfpde.ot under random input, sound and unsound: an answer with its proof, or an error that says why not.

A million inputs, some minutes:  NFPDE_FUZZ=1000000 pytest tests/test_ot_fuzz.py
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pytest

from nfpde.errors import BadInput
from nfpde.ot import EmdResult, emd, emd_matrix, wasserstein
from tests.ot_cases import distances, least_size

COUNT = int(os.environ.get("NFPDE_FUZZ", "4000"))
BATCH = 1000
METRICS = ("euclidean", "sqeuclidean", "cityblock")

#: Sums of some dozen products, and costs that the test computes in another order.
ROUNDING = 1e-12
#: What may be left unproven of any cost.
GAP = 1e-12
#: Where squares and sums neither overflow nor vanish, the test can compute every cost itself.
SAFE = (1e-140, 1e140)
#: What an answer is refused for although every argument keeps the rules.
OUT_OF_RANGE = "outside the range of numbers|scale them|lower p"


@dataclass
class Input:
    """Arguments, and the texts of the errors that are due (none: an answer is due)."""

    x: Any
    y: Any
    a: Any
    b: Any
    due: list[str] = field(default_factory=list)


def _points(rng: np.random.Generator, n: int, d: int, kind: int) -> np.ndarray:
    """Clouds, lattices, repeated points, far clouds, extreme scales, or all of it mixed."""
    points = rng.normal(size=(n, d))
    if kind == 1:
        return np.round(points)
    if kind == 2:
        return points[rng.integers(0, max(n // 3, 1), n)]
    if kind == 3:
        return points + 10.0 ** rng.integers(0, 9)
    if kind == 4:
        return points * 10.0 ** rng.integers(-307, 308)
    if kind == 5:
        return rng.choice([0.0, -0.0, 1.0, -1.0, 1e-9, 1 / 3, 5e-324, 1e-160], (n, d))
    return points


def _weights(rng: np.random.Generator, n: int) -> np.ndarray:
    """Weights of total 1: equal, random, over many decades, with zeros, or one that has nearly all."""
    kind = rng.integers(6)
    raw = np.ones(n) if kind == 0 else rng.exponential(size=n) ** (9 if kind == 2 else 1)
    if kind == 3:
        raw = np.round(2 * raw)
    if kind == 4:
        raw[rng.integers(n)] = 1e15
    if kind == 5:
        raw = raw * 10.0 ** -rng.integers(0, 40, n)
    if not raw.any():
        raw[rng.integers(n)] = 1
    return raw / raw.sum()


def _spoil(rng: np.random.Generator, made: Input) -> None:
    """Breaks one rule."""
    kind, side = rng.integers(8), "xy"[rng.integers(2)]
    points = getattr(made, side)
    if kind <= 1:
        points[rng.integers(len(points)), rng.integers(points.shape[1])] = rng.choice([np.nan, np.inf, -np.inf])
        made.due.append("must be finite")
    elif kind == 2:
        setattr(made, side, points[:0] if rng.random() < 0.5 else points[:, :0])
        made.due += ["it is empty", "coordinates a point and y has"]
    elif kind == 3:
        made.x = np.hstack([made.x, made.x])
        made.due.append("coordinates a point and y has")
    elif kind == 4:
        made.x = made.x[0] if rng.random() < 0.5 else made.x[None]
        made.due.append("must have 2 dimensions")
    elif made.a is not None:
        i = rng.integers(len(made.a))
        if kind == 5:
            made.a[i] = rng.choice([-1e-3, np.nan, np.inf])
            made.due += ["must not be negative", "must be finite"]
        elif kind == 6 and made.b is not None:
            made.a[i] += 1e-8
            made.due.append("must have one total")
        elif kind == 7:
            made.a = np.append(made.a, 0.0)
            made.due.append("weights for")


def _input(rng: np.random.Generator) -> Input:
    top = (7, 7, 7, 7, 7, 30, 30, 90)[rng.integers(8)] if rng.random() < 0.99 else 300
    n, m, d = [*rng.integers(1, top, 2).tolist(), int(rng.integers(1, 5)) if rng.random() < 0.9 else 13]
    kind, kind_y = rng.integers(0, 6, 2)
    x, y = _points(rng, n, d, kind), _points(rng, m, d, kind if rng.random() < 0.8 else kind_y)
    if rng.random() < 0.1:
        y[rng.integers(m)] = x[rng.integers(n)]
    a = _weights(rng, n) if rng.random() < 0.7 else None
    b = _weights(rng, m) if rng.random() < 0.7 else None
    made = Input(x, y, a, b)
    if rng.random() < 0.15:
        _spoil(rng, made)
    elif rng.random() < 0.1:
        made.x = np.asfortranarray(made.x)
        made.y = np.repeat(np.asarray(made.y), 2, axis=0)[::2]
    return made


def _check(result: EmdResult, cost: np.ndarray | None, made: Input) -> None:
    """Margins, gap and, where the test can compute the costs, the cost and every reduced cost."""
    n, m = result.plan.shape
    a = np.full(n, 1 / n) if made.a is None else made.a
    b = np.full(m, 1 / m) if made.b is None else made.b
    plan, (alpha, beta) = result.plan, result.potentials
    assert len(plan.mass) < n + m
    assert (plan.mass > 0).all()
    assert np.abs(np.bincount(plan.rows, plan.mass, n) - a).max() <= ROUNDING
    assert np.abs(np.bincount(plan.cols, plan.mass, m) - b).max() <= ROUNDING
    assert math.isfinite(result.cost)
    # What rounding leaves of a dual value far larger than the cost: ten units, for eight that the solver excuses.
    assert abs(result.gap) <= GAP * abs(result.cost) + 10 * np.finfo(float).eps * least_size(alpha, beta, a, b)
    if cost is not None:
        # A reduced cost is as exact as the numbers it is made of, among them sums of costs along the plan.
        scale = np.abs(cost) + np.abs(alpha)[:, None] + np.abs(beta) + np.median(np.abs(cost))
        sums = (n + m) * np.finfo(float).eps * np.abs(cost).max()
        assert (cost - alpha[:, None] - beta >= -ROUNDING * scale - sums).all()
        priced = cost[plan.rows, plan.cols]
        assert abs(result.cost - plan.mass @ priced) <= ROUNDING * (plan.mass @ np.abs(priced))


def _costs(made: Input, metric: str) -> np.ndarray | None:
    """All costs, where they lie well inside the range of numbers."""
    with np.errstate(all="ignore"):
        cost = distances(made.x, made.y, metric)
        squares = distances(made.x, made.y, "sqeuclidean")
    sound = (squares == 0) | ((squares > SAFE[0]) & (squares < SAFE[1]))
    exact = (made.x[:, None] == made.y).all(axis=2) == (squares == 0)
    return cost if sound.all() and exact.all() else None


def _try(rng: np.random.Generator, outcomes: Counter[str]) -> None:
    made = _input(rng)
    metric, call = METRICS[rng.integers(3)], rng.integers(8)
    cost = None
    if call == 0:
        p = float(rng.choice([1, 1.5, 2, 3, 40]))
        solve: Callable[[], Any] = partial(wasserstein, made.x, made.y, p, made.a, made.b)
    elif call <= 2 and not made.due:
        cost = rng.normal(size=(len(made.x), len(made.y))) * 10.0 ** rng.integers(-300, 300)
        cost = np.round(rng.normal(size=cost.shape)) if call == 1 else cost
        solve = partial(emd_matrix, cost, made.a, made.b)
    else:
        solve = partial(emd, made.x, made.y, made.a, made.b, metric, threads=1 if call < 7 else 2)
    try:
        result = solve()
    except BadInput as error:
        text = str(error)
        assert any(due in text for due in made.due) or any(part in text for part in OUT_OF_RANGE.split("|")), text
        outcomes["refused" if made.due else "out of range"] += 1
        return
    assert not made.due, made.due
    outcomes["solved"] += 1
    if isinstance(result, EmdResult):
        _check(result, _costs(made, metric) if cost is None else cost, made)
    else:
        assert math.isfinite(result)
        assert result >= 0


@pytest.mark.filterwarnings("ignore:overflow|invalid|underflow:RuntimeWarning")
def test_random_input():
    """Every input of some thousand is solved with its proof, or refused for a reason that it has."""
    outcomes: Counter[str] = Counter()
    for batch in range(-(-COUNT // BATCH)):
        rng = np.random.default_rng(batch)
        for trial in range(BATCH):
            try:
                _try(rng, outcomes)
            except Exception as error:
                raise AssertionError(f"batch {batch}, trial {trial}, so far {dict(outcomes)}: {error!r}") from error
    print(dict(outcomes))
    assert outcomes["solved"] > outcomes["refused"] > 0
