"""How much noise the sensors have, from recordings and a model that need not be right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.grain import encoder_grain
from nfpde.gap.replay import Replay, started_beside

Array = NDArray[np.float64]

_MAD = 1.4826
"""Ratio of standard deviation to median absolute deviation of a Gaussian."""

_ROWS = 300
"""Rows at which it is found out how noise spreads within a step."""

_MOST, _MEAN = 4.0, 0.9205
"""Squared ratios to the expected spread are capped, for contacts and jumps; mean of the square of a Gaussian so capped
(chi-square with one degree of freedom)."""

_ROUNDS = 200


def sensor_noise(replay: Replay, xi: Array, rows: Windows) -> Array:
    """Standard deviation of the sensors' noise on every channel of a difference, (2 nv,).

    One-step residuals r(t) = e(t+1) - A e(t) + gap hold the noise e twice. The second difference
    r(t) - (r(t-1) + r(t+1)) / 2 removes a gap that lasts for a few steps. What noise spreads to in a step, A, is
    simulated at some rows: near one in free motion, near zero or far beyond one where contacts push. The noise is
    what makes these differences likeliest, and at most what the third differences of the recordings themselves show;
    yet at least that of the grain of an encoder: at rest it errs by the same in every row, and no difference shows it.

    Args:
        replay: The model that predicts.
        xi: Its free parameters (D,).
        rows: Windows of one control step, many of them in succession.
    """
    grain = encoder_grain(replay.sim.model, rows) / np.sqrt(12.0)
    return np.maximum(_varying_noise(replay, xi, rows), grain)


def _varying_noise(replay: Replay, xi: Array, rows: Windows) -> Array:
    """Noise that differs from row to row (2 nv,)."""
    states = replay.sim.states
    there = replay.predict(xi[None], rows)[0]
    r = states.difference(there, rows.target)[:, 0]
    follows = (np.diff(rows.row) == 1) & (np.diff(rows.episode) == 0)
    middle = np.flatnonzero(follows[:-1] & follows[1:]) + 1
    if len(middle) < 8:
        return np.zeros(r.shape[1])
    high = r[middle] - 0.5 * (r[middle - 1] + r[middle + 1])
    sound = np.isfinite(high).all(1)
    middle, high = middle[sound], high[sound]
    calm = _spread(high, rows.episode[middle]) / np.sqrt(5.0)
    some = np.unique(np.linspace(0, len(middle) - 1, _ROWS).round().astype(int)) if len(middle) else np.zeros(0, int)
    if not len(some):
        return calm
    found = _likeliest(high[some], _gains(replay, xi, rows, middle[some], calm), calm)
    moved = states.difference(rows.target, rows.state[:, :1])[:, 0]
    third = moved[middle + 1] - 2 * moved[middle] + moved[middle - 1]
    return np.minimum(found, _spread(third, rows.episode[middle]) / np.sqrt(20.0))


def _spread(values: Array, episode: NDArray[np.intp]) -> Array:
    """Robust standard deviation of every column about zero: root mean square over episodes of each one's.

    The median of episodes with unlike noise would lie below their mean square.
    """
    parts = [values[episode == e] for e in np.unique(episode)]
    variance = [len(p) * (_MAD * np.median(np.abs(p), axis=0)) ** 2 for p in parts]
    return np.sqrt(np.sum(variance, axis=0) / max(1, len(values))) * np.ones(values.shape[1])


def _gains(replay: Replay, xi: Array, rows: Windows, middle: NDArray[np.intp], size: Array) -> Array:
    """By how much the variance of each noise (last axis) adds to that of each second difference, (n, 2 nv, 2 nv)."""
    count, channels = len(middle), len(size)
    near = rows[np.concatenate([middle - 1, middle, middle + 1])]
    there = replay.predict(xi[None], near)[0]
    a = np.zeros((3 * count, channels, channels))
    sign = (-1.0) ** np.arange(3 * count)[:, None]  # up and down: a contact opens one way and presses the other
    for channel in np.flatnonzero(size > 0):
        moved = started_beside(replay.sim.model, near, sign * size * (np.arange(channels) == channel))
        apart = replay.sim.states.difference(replay.predict(xi[None], moved)[0], there)[:, 0]
        a[..., channel] = np.nan_to_num(apart / (sign * size[channel]), posinf=0.0, neginf=0.0)
    before, now, after = a.reshape(3, count, channels, channels)
    one = np.eye(channels)
    return 0.25 * before**2 + (now + 0.5 * one) ** 2 + (one + 0.5 * after) ** 2 + 0.25 * one


def _likeliest(high: Array, gains: Array, start: Array) -> Array:
    """Standard deviations of independent noises whose sums, weighted by `gains`, make `high` (n, C) likeliest.

    Multiplicative updates towards the maximum of the Gaussian likelihood, squares far beyond the expected ones capped.
    """
    variance, squares = start**2, high**2
    seen = np.flatnonzero(variance > 0)
    for _ in range(_ROUNDS):
        expected = np.maximum(gains @ variance, 1e-300)
        ratio = np.minimum(squares / expected, _MOST) / _MEAN
        up = np.einsum("nij,ni->j", gains, ratio / expected, optimize=True)
        down = np.einsum("nij,ni->j", gains, 1.0 / expected, optimize=True)
        variance[seen] *= np.sqrt(up[seen] / down[seen])
    return np.sqrt(variance)
