"""What a diagnosis found, measured: how far the gap shrinks, how sure the values are, what noise leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset, Windows
from nfpde.effects import LINEAR, Effect, slides
from nfpde.gap.accepted import Accepted, called, key
from nfpde.gap.certainty import standard_errors
from nfpde.gap.distance import distance
from nfpde.gap.fit import Fit
from nfpde.gap.levels import FLOOR_ERROR, NEAR_FLOOR, Yardstick, least_ratio, rare, shrink_interval
from nfpde.gap.lone import lone_windows
from nfpde.gap.loud import noise_residuals
from nfpde.gap.recordings import Recordings, blocks_of, joined
from nfpde.gap.report import Cause, Distance, Level
from nfpde.gap.select import Selection
from nfpde.gap.stage import Stage
from nfpde.gap.trial import Trial
from nfpde.gap.values import fitted_values

Array = NDArray[np.float64]

PART = 4
"""One of so many held-out windows is asked how well the values of effects that were told apart are known."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """All that a diagnosis found.

    stage: the windows on which the gap is measured
    near: those on which it was explained: the same, or shorter ones
    final: parameters and effects fitted
    accepted: effects in the order of their acceptance, which is their order in `final`
    sigma: noise of the sensors (2 nv,); typical: generalized forces (nv,)
    computed: which velocities do not count and why, in words
    error: by how much joints at rest read too high (nv,); the recordings are without it
    by: windows of the joints that alone told what was found, where not all did: values are known by these
    """

    dataset: Dataset
    stage: Stage
    near: Stage
    final: Trial
    accepted: tuple[Accepted, ...]
    selection: Selection
    sigma: Array
    typical: Array
    seed: int
    computed: str
    error: Array
    by: Stage | None = None

    @property
    def recordings(self) -> Recordings:
        """The windows."""
        return self.stage.recordings

    @property
    def base(self) -> Trial:
        """Parameters fitted, without effects."""
        return self.stage.base

    @property
    def yardstick(self) -> Yardstick:
        """Measures the gap."""
        return self.stage.yardstick

    @cached_property
    def without(self) -> list[Trial]:
        """For each accepted effect, the best model without it."""
        if len(self.accepted) == 1:
            return [self.base]
        return [self.selection.without(self.final, i) for i in range(len(self.accepted))]

    def level(self, horizon: int | None) -> Level:
        """The ladder at one horizon (an index), or over all."""
        unit, columns = self.unit(horizon), self._columns(horizon)
        stages = [self.yardstick.squares(r) for r in (self.stage.nominal, self.base.held, self.final.held)]
        return Level(*(float(squares[..., columns].mean()) / unit for squares in (*stages, self.yardstick.floor)))

    def unit(self, horizon: int | None = None) -> float:
        """What gaps count in, at one horizon (an index) or over all: the nominal model's own, or what rounding may do.

        A model that reproduces the recordings to rounding leaves nothing that others could be compared with.
        """
        columns = self._columns(horizon)
        nominal = float(self.yardstick.squares(self.stage.nominal)[..., columns].mean())
        rounding = float(np.square(self.yardstick.precision / self.yardstick.scale)[..., columns].mean())
        return max(nominal, rounding, 1e-300)

    def _columns(self, horizon: int | None) -> slice:
        """Channels of a degree of freedom that are compared at one horizon (an index), or all."""
        return slice(None) if horizon is None else slice(horizon, None, len(self.recordings.horizons))

    def least_over_floor(self) -> float:
        """Gap that is left in noise floors, the lower end of its 95 % interval.

        Where contacts open and close, few windows hold most of the noise and of the gap, and their ratio is uncertain.
        A single joint may stand out all the same: where no effect was found, the joint with the largest ratio counts,
        unless noise makes one stand out as far.
        """
        if self._exact:
            return 0.0
        floor, gap = self.yardstick.floor.mean((1, 2)), self.yardstick.gap(self.final.held)
        least = float(least_ratio(gap[:, None], floor[:, None], self.recordings.block, self.seed)[0])
        chosen = self.selection
        if chosen.sigma is None or self.accepted:
            return least
        standing = max(least, chosen.beyond(self.final))
        noise = standing > NEAR_FLOOR and chosen.by_chance(self.final, standing)
        return NEAR_FLOOR if noise else standing

    def rare(self) -> float:
        """Probability of the windows with the largest gap of both halves, were there nothing but noise."""
        return 1.0 if self._exact else rare(*self._gaps)

    def lone(self) -> Windows:
        """The windows of both halves that noise is least likely to give, the largest gap first; see `rare`."""
        every = joined(self.recordings.held, self.recordings.fit)
        return every[np.zeros(0, np.intp) if self._exact else lone_windows(*self._gaps)]

    @property
    def _gaps(self) -> tuple[Array, Array, NDArray[np.intp]]:
        """Gaps of the windows of both halves, those that noise gives, and groups of windows, held-out ones first."""
        halves = [self.final.held, self.final.fit.residuals]
        gap = np.concatenate([self.yardstick.gap(r) for r in halves])
        block = np.concatenate([self.recordings.block, -1 - blocks_of(self.recordings.fit)])
        noise = np.concatenate([self.yardstick.gap(draw) for draw in self.yardstick.noise])
        return gap, NEAR_FLOOR * noise, block

    @property
    def _exact(self) -> bool:
        """Whether no window shows anything beyond rounding, or beyond a trace of what there was."""
        halves = [self.final.held, self.final.fit.residuals]
        return max(float(self.yardstick.gap(r).max()) for r in halves) < FLOOR_ERROR

    def distance(self) -> Distance:
        """How far apart recorded and simulated states lie at the windows' ends."""
        base, final, held = self.base.fit, self.final.fit, self.recordings.held
        nominal = self.stage.court.nominal[None]
        at = [(base.replay, nominal), (base.replay, base.xi[None]), (final.replay, final.xi[None])]
        ends = [replay.predict(xi, held)[0, :, -1] for replay, xi in at]
        count = len(self.recordings.horizons)
        fitter = self.stage.court.held
        draw = noise_residuals(final.replay, final.xi, held, fitter.horizons, self.sigma, self.seed)[0]
        noise = np.concatenate([draw[..., i] for i in (count - 1, 2 * count - 1)], axis=1)
        return distance(base.replay.sim.states, held, ends, noise, self.sigma)

    @cached_property
    def explained(self) -> Trial:
        """What was found on the windows on which it was explained."""
        return self.final if self.near is self.stage else self.near.shown(self.final, refitted=False)

    @cached_property
    def errors(self) -> Array:
        """Standard errors of what was found (D,)."""
        court = self._by.court
        shown = self.explained if self.by is None else self.by.shown(self.final, refitted=False)
        return standard_errors(court, court.fitter.resolved(shown.fit))

    @property
    def _by(self) -> Stage:
        """The windows by which values are known."""
        return self.near if self.by is None else self.by

    def errors_of(self, trial: Trial) -> Array:
        """Standard errors of another model's parameters (D,), on the same windows: contacts tear long ones apart.

        For an effect that was told apart less will do: in smooth motion slopes, which tell them to within a factor of
        two; beside contacts a part of the windows, which know less than all.
        """
        effects = [key(e) for e in trial.fit.replay.effects]
        if effects == [key(e) for e in self.final.fit.replay.effects]:
            return self.errors
        court = self._by.court
        shown = court.fitter.resolved(self._by.shown(trial, refitted=False).fit)
        rivals = {key(t.effect) for a in self.accepted for t in a.rivals if t.effect is not None}
        if effects[-1] in rivals:
            return standard_errors(court, shown)
        if self.selection.sigma is None:
            return shown.standard_errors
        some = np.arange(0, len(court.held.windows), PART)
        return standard_errors(replace(court, held=court.held.some(some)), shown)

    def cause(self, effect: Effect, fit: Fit, errors: Array, before: Trial, after: Trial) -> Cause:
        """An effect as it stands in a fit; `before` and `after` are the models without and with it."""
        index = [key(e) for e in fit.replay.effects].index(key(effect))
        block = self.recordings.block
        gaps = [self.yardstick.gap(t.held) for t in (before, after)]
        shrink, low, high = shrink_interval(gaps[0], gaps[1], block, self.seed)
        if gaps[0].mean() <= self.yardstick.rounding:  # no share of what is none
            shrink = low = high = 0.0
        gain, error, _ = self.selection.court.gain(after, before)
        columns = fit.replay.columns(index)
        quantities = effect.bind(self.selection.model).quantities
        values = fitted_values(fit, errors, columns, [q.name for q in quantities], quantities)
        if slides(self.selection.model, effect):
            values = {n: replace(v, unit=LINEAR.get(v.unit, v.unit)) for n, v in values.items()}
        name, target = called(effect)
        reading = effect.name if effect.says else ""
        return Cause(name, target, effect.sentence, values, shrink, low, high, gain, error, reading=reading)
