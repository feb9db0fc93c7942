"""Residuals of both halves counted in how loud noise is in their windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.directions import likeliest_directions, noise_covariance
from nfpde.gap.fit import Fit
from nfpde.gap.loud import loudness
from nfpde.gap.noise import floor_of, learn_scatter, precision_of
from nfpde.gap.trial import Court, noise_of

Array = NDArray[np.float64]


def quietened(
    court: Court, base: Fit, left: Array, known: Fit, sigma: Array, seed: int, *, whole: bool
) -> tuple[Court, Array]:
    """A court that counts residuals by the noise of their windows.

    Args:
        court: That counts all windows alike.
        base: The parameters fitted.
        left: What they leave in both halves, those to fit first (N, nv, C).
        known: A model that knows what noise does.
        sigma: Noise of the sensors (2 nv,).
        seed: Of its draws.
        whole: Whether noise is followed in all its directions: what that takes grows with the square of the channels.

    Returns:
        The court, and what noise alone leaves in the held-out windows, counted likewise (draws, held, nv, C).
    """
    halves = court.fitter, court.held
    noise = np.concatenate([noise_of(known, sigma, half, seed) for half in halves], axis=1)
    loud = loudness(noise, left, court.floor)
    if whole:
        replay, loose = known.replay, court.encoders.loose
        parts = [
            noise_covariance(replay, known.xi, half.windows, half.horizons, sigma, half.seen, loose, half.force)
            for half in halves
        ]
        # starts whose velocity nobody measured make most of the residuals: a share of these is no floor
        floor = court.floor if court.fitter.channels is None else precision_of(court.fitter.moved(base.replay))
        loud = likeliest_directions(np.concatenate(parts), left, floor, loud)
    count = len(court.fitter.windows)
    fitter = replace(court.fitter, noise=loud.some(slice(None, count)))
    held = replace(court.held, noise=loud.some(slice(count, None)))
    floor = floor_of(fitter.quieten(left[:count]), fitter.moved(base.replay))
    quiet = learn_scatter(fitter.quieten(noise[:, :count]).reshape(-1, *floor.shape), 0, floor)
    return replace(court, fitter=fitter, held=held, floor=floor, quiet=quiet), held.quieten(noise[:, count:])
