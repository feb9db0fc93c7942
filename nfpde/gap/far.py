"""The longest windows, over which a gap is counted in the end: what is small over a few steps may be large there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.fit import Fitter
from nfpde.gap.levels import Yardstick
from nfpde.gap.loud import loudness
from nfpde.gap.noise import floor_of
from nfpde.gap.recordings import Recordings, joined
from nfpde.gap.trial import Trial, noise_of

Array = NDArray[np.float64]

SEED = 0
"""Of the draws of noise."""


@dataclass(eq=False)
class Far:
    """Gaps over the longest windows of both halves, as models stand that were fitted to shorter ones.

    recordings: in the longest windows
    capped: share of the largest squares that are capped
    """

    recordings: Recordings
    capped: float
    _measures: dict[Trial, _Measure] = field(default_factory=dict)

    def gaps(self, current: Trial, trial: Trial, sigma: Array) -> tuple[float, float]:
        """What two models leave, in noise of the sensors (2 nv,) as the first one sees it."""
        if current not in self._measures:
            self._measures[current] = self._measure(current, sigma)
        measure = self._measures[current]
        return measure.before, measure.gap(trial)

    def _measure(self, current: Trial, sigma: Array) -> _Measure:
        windows = joined(self.recordings.fit, self.recordings.held)
        plain = Fitter(
            windows, self.recordings.horizons, channels=self.recordings.channels, force=self.recordings.force
        )
        replay = current.fit.replay
        left, noise = plain.residuals_at(replay, current.fit.xi[None])[0], noise_of(current.fit, sigma, plain, SEED)
        loud = loudness(noise, left, floor_of(left, plain.moved(replay)))
        left = loud.quieten(left)
        yardstick = Yardstick.of(loud.quieten(noise), left, self.capped)
        return _Measure(replace(plain, noise=loud), yardstick, float(yardstick.gap(left).mean()))


@dataclass(frozen=True, eq=False)
class _Measure:
    """Counts gaps as a model sees noise.

    fitter: of the windows
    yardstick: measures them
    before: gap that the model leaves
    """

    fitter: Fitter
    yardstick: Yardstick
    before: float

    def gap(self, trial: Trial) -> float:
        """What another model leaves."""
        return float(self.yardstick.gap(self.fitter.residuals_at(trial.fit.replay, trial.fit.xi[None])[0]).mean())
