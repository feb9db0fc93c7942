"""By how much the noise of the sensors is misjudged beside contacts: found again in recordings that have a known one.

What contacts bend is told from noise by assumptions that are true in part. Recordings that the model would have made,
with the noise that was found, show what is found in them (bias correction by a parametric bootstrap: Efron, Tibshirani,
An introduction to the bootstrap, 1993, chapter 10).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.brief import shorter
from nfpde.gap.grain import Encoders
from nfpde.gap.natural import measured, natural
from nfpde.gap.replay import Replay
from nfpde.gap.sensors import sensor_noise

Array = NDArray[np.float64]

DRAWS = 3
"""Recordings made, of which the geometric mean counts: each noise is found to a tenth or so."""

MOST = 2.0
"""Factor by which noise is misjudged at most: beyond it the model is not what made the recordings."""


def misjudged(replay: Replay, xi: Array, windows: Windows, encoders: Encoders, sigma: Array, seed: int) -> Array:
    """What is found of the noise of every sensor, as a share of it (2 nv,); one where there is none.

    Args:
        replay: The model.
        xi: Its free parameters (D,).
        windows: Of recordings, in the longest windows.
        encoders: Of the recordings.
        sigma: The noise that was found in them (2 nv,).
        seed: Of the draws.
    """
    truth, rng = natural(replay, xi, windows), np.random.default_rng(seed)
    logs = np.zeros(len(sigma))
    for _ in range(DRAWS):
        rows = shorter(measured(replay, truth, sigma, windows, encoders, rng), 1, len(truth) * truth.horizon)
        again = sensor_noise(replay, xi, rows, encoders)
        noisy = (sigma > 0) & (again > 0)
        logs[noisy] += np.log(again[noisy] / sigma[noisy]) / DRAWS
    return np.clip(np.exp(logs), 1.0 / MOST, MOST)
