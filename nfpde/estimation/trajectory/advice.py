"""What to record next: simulated changes of the recorded moments, and how much more they would tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.estimation.trajectory.identify import UNIFORM_STD, Knowledge
from nfpde.estimation.trajectory.noise import Noise
from nfpde.estimation.trajectory.problem import Problem

Array = NDArray[np.float64]

WANTED = 0.05
"""Standard error that is worth recording for, in widths of the bounds."""

MOMENTS = 48
"""Recorded moments, spread over all recordings, that the changes are tried on."""

STEP, WIDEST = 1e-4, 0.01
"""Finite difference of a parameter, in widths of the bounds, in double and in single precision."""

WORTH = 1.5
"""Least gain in information that is worth asking for."""


def record_next(problem: Problem, rows: Sequence[Knowledge], noise: Noise) -> list[dict[str, Any]]:
    """For every parameter that half of the robots do not know to `WANTED`: which motion would tell it.

    Each recorded moment is simulated again with one velocity (or position, where there are none) pushed by its own
    root mean square up or down, or one command at its recorded extremes; the information about the parameter, averaged
    over the moments, is compared with that of the moments as recorded. Moments count with the learned noise.

    Returns:
        One table a parameter: `parameter`, `words`, `gains` of the three best changes (null where the recorded
        moments say nothing at all), and `times_longer`, how much more of the same would do.
    """
    space = problem.simulator.space
    errors = np.array([k.std for k in rows]) / space.width
    asked = [int(i) for i in np.argsort(-np.median(errors, axis=0)) if np.median(errors[:, i]) > WANTED][:5]
    if not asked:
        return []
    count = len(problem.windows)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOMENTS)).astype(int))
    windows = problem.windows[chosen]
    middle = np.median([k.value for k in rows], axis=0)
    changes = _changes(problem, windows)
    information = np.array([_information(problem, w, middle, asked, noise) for _, w in [("", windows), *changes]])
    advice = []
    for column, i in enumerate(asked):
        base, others = information[0, column], information[1:, column]
        order = np.argsort(-others, kind="stable")[:3]
        # below this a moment adds less than a millionth of what the bounds say
        blind = base < 1e-6 / UNIFORM_STD**2
        gains = [
            {"change": changes[k][0], "gain": None if blind else float(others[k] / base)}
            for k in order
            if others[k] > WORTH * base and others[k] >= 1e-6 / UNIFORM_STD**2
        ]
        typical = float(np.median(errors[:, i]))
        own = max(1 / typical**2 - 1 / UNIFORM_STD**2, 0.0)
        longer = None if blind or own <= 1e-6 / UNIFORM_STD**2 else float((1 / WANTED**2 - 1 / UNIFORM_STD**2) / own)
        words = _words(space[i].name, gains, longer, blind)
        advice.append({"parameter": space[i].name, "words": words, "gains": gains, "times_longer": longer})
    return advice


def _words(name: str, gains: list[dict[str, Any]], longer: float | None, blind: bool) -> str:
    if gains:
        first = gains[0]
        more = "" if first["gain"] is None else f" ({_times(first['gain'])} the information a moment)"
        text = f"{name}: record {first['change']}{more}"
        if len(gains) > 1:
            text += f", or {gains[1]['change']}"
    elif blind:
        return f"{name}: nothing tried, from faster joints to larger commands, would show it in these poses"
    else:
        text = f"{name}: no faster joint or larger command helps much"
    if longer is not None and longer < 1000:
        text += f"; about {longer:.0f} times as much of the same would tell it to {WANTED:.0%} of its bounds' width"
    return text


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


def _information(problem: Problem, windows: Windows, xi: Array, asked: list[int], noise: Noise) -> Array:
    """Mean information of a moment about each parameter asked for, in widths of the bounds to the power -2."""
    simulator, n = problem.simulator, len(windows)
    space, every = simulator.space, np.arange(len(windows))
    step = WIDEST if problem.coarse else STEP
    centre = simulator.rollout(xi[None], windows, np.zeros(n, int), every)
    found = []
    for i in asked:
        # a step towards the farther bound stays inside
        sign = 1.0 if xi[i] - space.low[i] < space.high[i] - xi[i] else -1.0
        moved = xi.copy()
        moved[i] += sign * step * space.width[i]
        slope = simulator.states.difference(simulator.rollout(moved[None], windows, np.zeros(n, int), every), centre)
        white = (slope.reshape(n, -1) / problem.unit / step) @ noise.alone
        squares = (white**2).sum(1)
        squares = squares[np.isfinite(squares)]
        # a contact that opens within the step is a jump and no information: the middle half of the moments counts
        low, high = np.quantile(squares, (0.25, 0.75)) if len(squares) else (0.0, 0.0)
        inside = squares[(squares >= low) & (squares <= high)]
        found.append(float(inside.mean()) if len(inside) else 0.0)
    return np.array(found)
