"""What to record next: simulated changes of the recorded moments, and how much more they would tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.estimation.trajectory.identify import TIED, UNIFORM_STD, Knowledge
from nfpde.estimation.trajectory.information import inverse, without_rounding
from nfpde.estimation.trajectory.noise import Noise
from nfpde.estimation.trajectory.problem import Problem

Array = NDArray[np.float64]

WANTED = 0.05
"""Standard error that is worth recording for, in widths of the bounds."""

MOMENTS = 48
"""Recorded moments, spread over all recordings, that the changes are tried on."""

STEP, WIDEST = 1e-4, 0.01
"""Finite difference of a parameter, in widths of the bounds, in double and in single precision."""

SLOPES = 1e-7
"""Share of the largest eigenvalue of information from one-sided differences below which another is their error."""

FEWEST = 4
"""Moments of which half lie between the quartiles: of two, none does."""

WORTH = 1.5
"""Least gain in information that is worth asking for."""

NOTHING = 0.01
"""Information, in what the bounds say, that is none."""

LONGEST = 1000.0
"""Times as much to record that nobody will."""

TOUCHING = 0.1
"""Correlation of the errors of two parameters from which one's matters for what the other needs."""


def record_next(problem: Problem, rows: Sequence[Knowledge], noise: Noise) -> list[dict[str, Any]]:
    """For every parameter that half of the robots do not know to `WANTED`: which motion would tell it.

    Each recorded moment is simulated again with one velocity (or position, where there are none) pushed by its own
    root mean square up or down, or one command at its recorded extremes. Compared is what as many such moments as a
    robot has would add to what the robot in the middle knows of the parameter by itself, all others being as uncertain
    as they are, with what as many more of the recorded ones would: what tells only the sum of two masses again is
    worth nothing to either. Moments count with the learned noise.

    Returns:
        One table a parameter: `parameter`, `words`, `gains` of the three best changes (null where the recorded
        moments say nothing at all), and `times_longer`, how much more of the same would do (null where none would).
    """
    space = problem.simulator.space
    errors = np.array([k.std for k in rows]) / space.width
    asked = [int(i) for i in np.argsort(-np.median(errors, axis=0)) if np.median(errors[:, i]) > WANTED][:5]
    if not asked:
        return []
    count = len(problem.windows)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOMENTS)).astype(int))
    windows = problem.windows[chosen]
    value = np.median([k.value for k in rows], axis=0)
    middle = {i: rows[int(np.argsort(errors[:, i], kind="stable")[len(rows) // 2])] for i in asked}
    tied = {i: np.abs(k.correlations[i]) for i, k in middle.items()}
    taking = [j for j in range(len(space)) if any(row[j] > TOUCHING for row in tied.values())]
    changes = _changes(problem, windows)
    information = [_information(problem, w, value, taking, noise) for w in [windows, *(w for _, w in changes)]]
    advice = []
    for i in asked:
        known = middle[i].covariance[np.ix_(taking, taking)] / np.outer(space.width[taking], space.width[taking])
        worth = _Worth.of(known, taking.index(i), count / len(rows))
        base, *others = (worth.added(matrix) for matrix in information)
        blind = base < NOTHING / UNIFORM_STD**2
        gains = [
            {"change": changes[k][0], "gain": None if blind else float(others[k] / base)}
            for k in np.argsort(-np.array(others), kind="stable")[:3]
            if others[k] > max(WORTH * base, NOTHING / UNIFORM_STD**2) and worth.tells(information[1 + k])
        ]
        longer = None if blind else worth.times_longer()
        partner = int(np.argmax(np.where(np.arange(len(space)) == i, 0.0, tied[i])))
        words = _words(space[i].name, gains, longer, blind, space[partner].name if tied[i][partner] >= TIED else "")
        advice.append({"parameter": space[i].name, "words": words, "gains": gains, "times_longer": longer})
    return advice


@dataclass(frozen=True, eq=False)
class _Worth:
    """What further moments would be worth to one of T parameters.

    before: information about all, in widths of the bounds to the power -2 (T, T)
    which: the parameter
    moments: how many are recorded at a time
    """

    before: Array
    which: int
    moments: float

    @classmethod
    def of(cls, covariance: Array, which: int, moments: float) -> _Worth:
        """From what is known, the bounds included, in widths of the bounds (T, T)."""
        return cls(inverse(covariance), which, moments)

    def added(self, matrix: Array) -> float:
        """Information about the parameter by itself that as many moments with the mean information `matrix` add."""
        return 1 / self._variance(self.before + self.moments * matrix) - 1 / self._variance(self.before)

    def tells(self, matrix: Array) -> bool:
        """Whether any number of such moments would tell the parameter to `WANTED`."""
        return self._variance(self.before + LONGEST * self.moments * matrix) <= WANTED**2

    def times_longer(self) -> float | None:
        """How many times as much of the same would tell the parameter to `WANTED`; None for more than `LONGEST`."""
        bounds = np.eye(len(self.before)) / UNIFORM_STD**2
        low, high = 1.0, LONGEST
        for _ in range(50):
            half = np.sqrt(low * high)
            enough = self._variance(bounds + half * (self.before - bounds)) <= WANTED**2
            low, high = (low, half) if enough else (half, high)
        return high if high < LONGEST else None

    def _variance(self, information: Array) -> float:
        return float(inverse(information)[self.which, self.which])


def _words(name: str, gains: list[dict[str, Any]], longer: float | None, blind: bool, partner: str) -> str:
    if gains:
        first = gains[0]
        more = "" if first["gain"] is None else f" ({_times(first['gain'])} the information)"
        text = f"{name}: record {first['change']}{more}"
        if len(gains) > 1:
            text += f", or {gains[1]['change']}"
    elif blind:
        tried = "nothing tried, from faster joints to larger commands,"
        if partner:
            return f"{name}: {tried} would tell it from {partner}; weigh or measure one of them"
        return f"{name}: {tried} would show it in these poses"
    else:
        text = f"{name}: no faster joint or larger command helps much"
    if longer is not None:
        text += f"; {_longer(longer)} as much of the same would tell it to {WANTED:.0%} of its bounds' width"
    return text


def _longer(times: float) -> str:
    return f"{times:.1f} times" if times < 3 else f"about {times:.0f} times"


def _times(gain: float) -> str:
    return f"{gain:.2g} times" if gain < 100 else "more than 100 times"


def _changes(problem: Problem, windows: Windows) -> list[tuple[str, Windows]]:
    """The recorded moments with one thing changed each, and what it is in words."""
    states = problem.simulator.states
    found = []
    fixed = {c for q, _ in states.quaternions for c in range(q, q + 4)}
    columns = range(states.nq, states.nx) if states.nv else [c for c in range(states.nq) if c not in fixed]
    names = [n.removeprefix("qvel ").removeprefix("qpos ") for n in states.channels]
    names = names[len(names) - states.nv :] if states.nv else names
    for name, column in zip(names, columns, strict=False):
        size = float(np.sqrt((problem.windows.state[:, 0, column] ** 2).mean()))
        for sign, words in ((1, "positive"), (-1, "negative")):
            if size > 0:
                state = windows.state.copy()
                state[:, 0, column] += sign * size
                what = "faster motion" if states.nv else "larger values"
                found.append((f"{what} of {name} in its {words} direction", replace(windows, state=state)))
    for k in range(windows.ctrl.shape[2]):
        recorded = problem.windows.ctrl[..., k]
        for extreme, words in ((recorded.max(), "highest"), (recorded.min(), "lowest")):
            ctrl = windows.ctrl.copy()
            ctrl[..., k] = extreme
            found.append((f"command {k} held at its {words}", replace(windows, ctrl=ctrl)))
    return found


def _information(problem: Problem, windows: Windows, xi: Array, taking: list[int], noise: Noise) -> Array:
    """Mean information of a moment about the parameters `taking` (T, T), in widths of the bounds to the power -2."""
    simulator, n = problem.simulator, len(windows)
    space, every = simulator.space, np.arange(len(windows))
    step = WIDEST if problem.coarse else STEP
    centre = simulator.rollout(xi[None], windows, np.zeros(n, int), every)
    slopes = np.empty((n, len(taking), centre[0].size))
    for k, i in enumerate(taking):
        # a step towards the farther bound stays inside
        sign = 1.0 if xi[i] - space.low[i] < space.high[i] - xi[i] else -1.0
        moved = xi.copy()
        moved[i] += sign * step * space.width[i]
        slope = simulator.states.difference(simulator.rollout(moved[None], windows, np.zeros(n, int), every), centre)
        slopes[:, k] = (slope.reshape(n, -1) / problem.unit / (sign * step)) @ noise.alone
    squares = (slopes**2).sum(2)
    slopes, squares = (a[np.isfinite(squares).all(1)] for a in (slopes, squares))
    if not len(slopes):
        return np.zeros((len(taking),) * 2)
    # a contact that opens within the step is a jump and no information: the middle half of the moments counts, and
    # all where they are too few to have one
    size = np.median(squares, axis=0)
    loudest = (squares / np.where(size > 0, size, np.inf)).max(1)
    low, high = np.quantile(loudest, (0.25, 0.75))
    if len(slopes) >= FEWEST:
        slopes = slopes[(loudest >= low) & (loudest <= high)]
    return without_rounding(np.einsum("nic,njc->ij", slopes, slopes) / len(slopes), SLOPES)
