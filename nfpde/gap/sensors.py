"""How much noise the sensors have, from recordings and a model that need not be right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from nfpde.dataset import Windows
from nfpde.gap.grain import Encoders
from nfpde.gap.levels import calm
from nfpde.gap.replay import Replay, displaced

Array = NDArray[np.float64]

_MAD = 1.4826
"""Ratio of standard deviation to median absolute deviation of a Gaussian."""

_ROWS, _VALUES = (60, 300), 5000
"""Rows at which it is found out how noise spreads within a step, least and most: so many values of all channels."""

_TAILS = 4.0
"""Degrees of freedom of the Student t that differences have: contacts and jumps make a few far too large."""

_DIGITS = 1e-13
"""Share of a covariance matrix, its channels scaled alike, that double precision cannot tell from nothing."""

_TURNS, _ROUNDS = 2, 60
"""Times that slopes are taken anew at what was found, and updates each time."""


def sensor_noise(replay: Replay, xi: Array, rows: Windows, encoders: Encoders) -> Array:
    """Standard deviation of the sensors' noise on every channel of a difference, (2 nv,).

    One-step residuals r(t) = e(t+1) - A e(t) + gap hold the noise e twice. The second difference
    r(t) - (r(t-1) + r(t+1)) / 2 removes a gap that lasts for a few steps. What noise spreads to in a step, A, is
    simulated at some rows: near one in free motion, near zero or far beyond one where contacts push. The noise is
    what makes all channels of these differences likeliest together, and at most what the third differences of the
    recordings themselves show; yet at least that of the grain of an encoder: at rest it errs by the same in every row,
    and no difference shows it. A velocity that was computed from positions has their noise, and errs by what it blurs:
    by no more than would move the model in a step to where it was not.

    Args:
        replay: The model that predicts.
        xi: Its free parameters (D,).
        rows: Windows of one control step, many of them in succession.
        encoders: Of the recordings.
    """
    grain = encoders.grain(replay.sim.model) / np.sqrt(12.0)
    r = replay.sim.states.difference(replay.predict(xi[None], rows)[0], rows.target)[:, 0]
    computed = None if encoders.computed is None else encoders.computed / rows.control_dt
    found = np.maximum(_varying_noise(replay, xi, rows, r, computed), grain)
    if computed is not None:
        position, velocity = found[: replay.nv], found[replay.nv :]
        blurred = np.sqrt(calm(r[:, : replay.nv] ** 2).mean(0)) / rows.control_dt
        noisy = np.hypot(velocity, position * np.sqrt((computed**2).sum(1)))
        velocity[:] = np.where(computed.any(1), np.maximum(noisy, blurred), velocity)
    return found


def _varying_noise(replay: Replay, xi: Array, rows: Windows, r: Array, computed: Array | None) -> Array:
    """Noise that differs from row to row (2 nv,), of residuals (N, 2 nv); of velocities without that of positions.

    Args:
        replay: The model that predicts.
        xi: Its free parameters (D,).
        rows: Windows of one control step.
        r: What they leave.
        computed: What velocities that nobody measured take of the positions around (nv, 3) [1/s].
    """
    states = replay.sim.states
    follows = (np.diff(rows.row) == 1) & (np.diff(rows.episode) == 0)
    middle = np.flatnonzero(follows[:-1] & follows[1:]) + 1
    if len(middle) < 8:
        return np.zeros(r.shape[1])
    high = r[middle] - 0.5 * (r[middle - 1] + r[middle + 1])
    sound = np.isfinite(high).all(1)
    middle, high = middle[sound], high[sound]
    each = _spread(high, rows.episode[middle]) / np.sqrt(5.0)
    count = int(np.clip(_VALUES // r.shape[1], *_ROWS))
    some = np.unique(np.linspace(0, len(middle) - 1, count).round().astype(int)) if len(middle) else np.zeros(0, int)
    if not len(some):
        return each
    found = each
    for _ in range(_TURNS):
        slopes, bent = _spreading(replay, xi, rows, middle[some], found)
        slopes = slopes if computed is None else _with_velocities(slopes, computed)
        found = _likeliest(high[some], slopes, bent, found)
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


def _spreading(replay: Replay, xi: Array, rows: Windows, middle: NDArray[np.intp], size: Array) -> tuple[Array, Array]:
    """What noise of some size at four rows in succession adds to every second difference of residuals.

    Returns:
        Slopes by each noise (last axis), (4, n, 2 nv, 2 nv), and second moments of what bends, (n, 2 nv, 2 nv).
    """
    near = rows[np.concatenate([middle - 1, middle, middle + 1])]
    up, down = displaced(replay, xi, near, (1,), size)[:, :, :, 0].reshape(2, len(size), 3, len(middle), len(size))
    before, now, after = np.moveaxis((up - down) / (2 * np.where(size > 0, size, 1.0))[:, None, None, None], 0, -1)
    one = np.eye(len(size))
    slopes = np.stack([-0.5 * before, now + 0.5 * one, -one - 0.5 * after, np.broadcast_to(0.5 * one, now.shape)])
    middling = 0.5 * (up + down)
    bent = np.einsum("ktni,ktnj,t->nij", middling, middling, np.array([0.25, 1.0, 0.25]), optimize=True)
    return slopes, bent


def _with_velocities(slopes: Array, computed: Array) -> Array:
    """Slopes (4, n, 2 nv, 2 nv), see `_spreading`, where positions' noise is in velocities, too: (6, n, 2 nv, 2 nv).

    It reaches the velocities of the rows before and after: six rows in succession have noise that counts.
    """
    nv = len(computed)
    wide = np.pad(slopes, ((1, 1), (0, 0), (0, 0), (0, 0)))
    by_velocity, before, after = wide[..., nv:], np.roll(wide, 1, 0)[..., nv:], np.roll(wide, -1, 0)[..., nv:]
    wide[..., :nv] += before * computed[:, 2] + by_velocity * computed[:, 1] + after * computed[:, 0]
    return wide


def _likeliest(high: Array, slopes: Array, bent: Array, start: Array) -> Array:
    """Standard deviations of independent noises (C,) that make differences (n, C) likeliest, directions and all.

    Beside contacts a position's noise moves all speeds, and always in the same proportion: across that direction their
    own noise is seen. Multiplicative updates towards the maximum of a Student t likelihood over variance components
    (Zhou, Hu, Zhou, Lange, MM algorithms for variance components models, 2019), times the square root of each: what can
    hardly be seen is no zero (Chung, Rabe-Hesketh, Dorie, Gelman, Liu, Psychometrika 2013).

    Args:
        high: The differences.
        slopes: What noise adds to them in proportion, see `_spreading`.
        bent: What it adds beyond that.
        start: First guess; what is zero there stays zero.
    """
    seen = np.flatnonzero(start > 0)
    if not len(seen):
        return start
    # columns: noise at the first of four rows, of every channel, then at the second, ...
    parts = np.moveaxis(slopes[:, :, seen[:, None], seen] * (start[seen] / start[seen][:, None]), 0, 2)
    parts, variance = parts.reshape(*parts.shape[:2], -1), np.ones(len(seen))
    differences, scale = high[:, seen] / start[seen], np.outer(start[seen], start[seen])
    # Gaussian noise alone shall be found as it is
    expected = chi2.ppf((np.arange(1000) + 0.5) / 1000, len(seen))
    usual = len(seen) / float(np.mean(expected / (_TAILS + expected)))
    fixed = bent[:, seen[:, None], seen] / scale + 1e-12 * np.eye(len(seen))
    for _ in range(_ROUNDS):
        factors = _root_of_inverse((parts * np.tile(variance, len(slopes))) @ parts.swapaxes(1, 2) + fixed)
        white, spread = (factors @ differences[..., None])[..., 0], factors @ parts
        weight = usual / (_TAILS + (white**2).sum(1))
        up = (weight[:, None] * np.einsum("ni,nij->nj", white, spread) ** 2).sum(0).reshape(len(slopes), -1).sum(0)
        down = (spread**2).sum((0, 1)).reshape(len(slopes), -1).sum(0)
        variance *= np.sqrt((up + 1.0 / variance) / down)
    found = np.zeros_like(start)
    found[seen] = start[seen] * np.sqrt(variance)
    return found


def _root_of_inverse(covariances: Array) -> Array:
    """Matrices F with F'F the inverses of covariance matrices (n, C, C), so that these are positive definite, too.

    Where a contact opens, clean recordings have what bends a billion times as large as noise, in one direction.
    """
    size = np.sqrt(np.einsum("nii->ni", covariances))
    alike = covariances / (size[:, :, None] * size[:, None]) + _DIGITS * np.eye(size.shape[1])
    return np.linalg.inv(np.linalg.cholesky(alike)) / size[:, None]
