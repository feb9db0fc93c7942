"""Whether recordings that no fit saw ask for a candidate: what it is worth, how sure that is, and who is its equal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.accepted import Accepted, key, simplest_first
from nfpde.gap.bootstrap import NoiseAlone
from nfpde.gap.chance import by_chance
from nfpde.gap.far import Far
from nfpde.gap.levels import FLOOR_ERROR, NEAR_FLOOR, Yardstick, least_ratio, near_floor
from nfpde.gap.rounds import Rounds
from nfpde.gap.score import HeldScore
from nfpde.gap.trial import APART, LEVEL, Trial, block_test, likelihood_test, noise_of

Array = NDArray[np.float64]
Chosen = tuple[Trial, Accepted]

WORTH = 0.02
"""Share of the gap that an effect must remove to be named: less is of no use."""

CLOSED = 0.9
"""Share of the gap beyond noise that must be explained for the verdict "effects"; with more left than that, something
else is at work."""

NOISE_SEED = 0
"""Of the draws of noise in which a gap may disappear."""

NOISE_TIMES = 3.0
"""What noise alone gives, times this, is what a candidate must gain near the noise floor: draws differ by a factor of
two where contacts multiply noise, and the noise of the sensors, whose square counts, is known to a tenth or two."""

REMEMBERED = 1
"""Models beside the last one of which it is remembered what noise alone gives: each holds its draws of all windows,
gigabytes on large robots. The search comes back to where it began; what is forgotten is drawn again, alike."""

LEAST_GAP = FLOOR_ERROR**2
"""Gap below which there is nothing to look for: residuals of a tenth of the noise that was believed."""

ALIKE = 0.5
"""Share of what the best effect removes of the gap by which another may fall behind and still count as equal, however
little that is."""

NEGLIGIBLE = 0.005
"""Share of the best effect's gain by which another may fall behind and still count as equal, however sure it is."""


@dataclass(eq=False, kw_only=True)
class Acceptance(Rounds):
    """Accepts candidates.

    yardstick: measures the gap
    sigma: noise of the sensors (2 nv,), where contacts decide what becomes of it; else None
    by_noise: what noise alone gives to candidates, by what they are beside
    scores: slopes of the held-out windows, by the model at which they are
    far: the longest windows, where these are shorter
    last: whether no longer windows follow
    below: whether a first effect is asked for below the floor of noise, though longer windows follow
    level: probability of accepting an effect where there is none, of this look at the recordings
    """

    yardstick: Yardstick
    sigma: Array | None = None
    by_noise: dict[Trial, NoiseAlone] = field(default_factory=dict)
    scores: dict[Trial, HeldScore] = field(default_factory=dict)
    far: Far | None = None
    last: bool = True
    below: bool = False
    level: float = LEVEL

    def accept(
        self,
        current: Trial,
        trials: Sequence[Trial],
        first_gap: float,
        level: float = LEVEL,
        settled: tuple[str, str] | None = None,
    ) -> Chosen | None:
        """The candidate that the held-out recordings ask for, if they ask for one.

        Args:
            current: The model without them.
            trials: The candidates, refitted.
            first_gap: Of the parameters alone.
            level: Probability of accepting one where there is nothing; of one that was accepted before, the whole.
            settled: Key of one that stays if none of the others takes its place: whether it is more than noise is not
                asked again.
        """
        gap = self.gap_of(current)
        near_noise = self.sigma is not None and gap * (1 - CLOSED) < self.floor(current)
        # a first effect near the noise may be small, as noise is asked what it gives; beside another, or far from the
        # noise, what leaves the gap explains nothing
        alone = near_noise and not current.fit.replay.effects
        worthy = [t for t in trials if self.shrinks(t, current, first_gap) or (alone and self.lessens(t, current))]
        # each is tested at its share of the level: any that passes has been asked for
        gains = {t: g for t in worthy for g in (self._gain(t, current, level / len(trials)),) if g > 0}
        doubted = self.sigma if near_noise else None

        def stands(trial: Trial) -> bool:
            if doubted is None or (trial.effect is not None and key(trial.effect) == settled):
                return True
            return not self.given_by_noise(trial, current, doubted, gains[trial] / NOISE_TIMES)

        best = next(filter(stands, gains), None)
        if best is None:
            return None
        gain = gains[best]
        block, likelier = self.court.block, []
        if self.sigma is not None:  # what is likelier still may be worth more over longer windows
            likelier = [t for t in trials if t not in worthy and t.density.mean() > best.density.mean()]
        near, equal = [], []
        for trial in (beside := [*likelier, *worthy]):
            behind, error, apart = block_test(best.density - trial.density, block)
            if behind < max(error if np.isfinite(error) else 0.0, NEGLIGIBLE * gain):
                near.append(trial)
            untold = apart > APART or trial in near
            untold = untold or (self.court.contradicted(best, trial) and self._leaves_nearly(gap, best, trial))
            if self._equal(gap, best, trial, untold):
                equal.append(trial)
        # within the standard error of the best, the one with fewest parameters, if it explains the same
        simplest = simplest_first([t for t in near if t in gains and t in equal])
        chosen = next(t for t in simplest if t is best or stands(t))
        # one half may know little of what the other tells: who is likelier in both together, and leaves far less
        clearer = [t for t in equal if t is not chosen and t in gains and self.court.contradicted(chosen, t)]
        clearer = [t for t in clearer if not self._leaves_nearly(gap, t, chosen) and stands(t)]
        chosen = min(clearer, key=self.gap_of, default=chosen)
        if chosen.effect is None:
            return None
        close = [t for t in beside if self._leaves_nearly(gap, best, t)]
        rivals, others = (tuple(t for t in some if t is not chosen) for some in (equal, close))
        return chosen, Accepted(chosen.effect, chosen, rivals, others, tuple(beside))

    def shrinks(self, trial: Trial, current: Trial, first_gap: float) -> bool:
        """Whether a trial shrinks the gap enough for a name, or that of most windows: a few may be another's work.

        What most windows gain must outweigh, as a factor, what those few lose. What is less than an error of the floor
        is looked at on the last windows beside contacts alone, where simulated noise says what it gives by itself.
        What rounding may do is nobody's work. What these windows are too short to show much of is worth what it is over
        the longest, if it shrinks the gap here at all.
        """
        rounding = self.yardstick.rounding
        least = rounding if self.sigma is not None and self.last else max(FLOOR_ERROR, rounding)
        gap, left = self.gap_of(current), self.gap_of(trial)
        if gap - left >= max(rounding, min(WORTH * first_gap, max(WORTH * gap, least))):
            return True
        usual, usual_left = self._usual_gap(current), self._usual_gap(trial)
        if usual - usual_left >= max(WORTH * usual, least) and left * usual_left < gap * usual:
            return True
        if self.sigma is None or self.far is None or left > gap - rounding:
            return False
        return self._shrinks_far(trial, current, self.far, self.sigma) >= WORTH

    def lessens(self, trial: Trial, current: Trial) -> bool:
        """Whether a trial leaves less of the gap, however little, in the mean and in most windows.

        Over the longest windows it must not leave more, by what counts there.
        """
        rounding = self.yardstick.rounding
        if self.gap_of(trial) >= self.gap_of(current) - rounding or self._usual_gap(trial) >= self._usual_gap(current):
            return False
        if self.sigma is None or self.far is None:
            return True
        return self._shrinks_far(trial, current, self.far, self.sigma) > -WORTH

    def _shrinks_far(self, trial: Trial, current: Trial, far: Far, sigma: Array) -> float:
        """Share of the gap over the longest windows that a trial removes."""
        before, after = far.gaps(current, trial, sigma)
        self.count(trial.fit.replay, current.fit.replay)
        return (before - after) / max(before, 1e-300)

    def at_floor(self, trial: Trial) -> bool:
        """Whether noise alone would leave as much; where contacts are, the floor is known to a factor only."""
        if self.sigma is None:
            return self._gap(trial) < self.floor(trial) + FLOOR_ERROR
        return self.gap_of(trial) < near_floor(self.floor(trial))

    def in_noise(self, base: Trial) -> bool:
        """Whether noise beside contacts leaves as much as there is; in smooth motion a test finds what is below it."""
        return self.sigma is not None and self.gap_of(base) < self.floor(base) + FLOOR_ERROR

    def spotless(self, trial: Trial) -> bool:
        """Whether a trial leaves next to nothing of what noise would: then the noise was overestimated, too."""
        return self.gap_of(trial) < LEAST_GAP

    def floor(self, trial: Trial) -> float:
        """The gap that noise alone leaves."""
        return max(float(floor.mean()) for floor in self._floors(trial))

    def stands_out(self, trial: Trial) -> bool:
        """Whether any joint has a gap that is surely not its noise."""
        least = self.beyond(trial)
        return least > NEAR_FLOOR and not self.by_chance(trial, least)

    def beyond(self, trial: Trial) -> float:
        """Gap at the joint where it is largest, in noise floors, the lower end of its 95 % interval."""
        return self._beyond(trial.held, self._floors(trial))

    def by_chance(self, trial: Trial, least: float) -> bool:
        """Whether noise alone makes a joint stand out as far as that, where contacts make much of noise."""
        if self.sigma is None:
            return False
        floors = self._floors(trial)
        found = by_chance(trial.fit, self.sigma, self.court.held, lambda draw: self._beyond(draw, floors), least)
        self.count(trial.fit.replay)
        return found

    def _beyond(self, residuals: Array, floors: Sequence[Array]) -> float:
        by_joint = [floor.mean(2) for floor in floors]
        largest = np.argmax([floor.mean(0) for floor in by_joint], axis=0)
        floor = np.take_along_axis(np.array(by_joint), largest[None, None], axis=0)[0]
        squares = self.yardstick.squares(residuals).mean(2)
        return float(least_ratio(squares, floor, self.court.block, NOISE_SEED).max())

    def _floors(self, trial: Trial) -> list[Array]:
        """Squares that noise alone leaves (N, nv, C); where contacts are, as the trial's own model sees it, too.

        A model that touches nothing knows nothing of what contacts make of noise.
        """
        if self.sigma is None:
            return [self.yardstick.floor]
        held = self.court.held
        noise = held.quieten(noise_of(trial.fit, self.sigma, held, NOISE_SEED))
        return [self.yardstick.floor, np.mean([self.yardstick.squares(draw) for draw in noise], axis=0)]

    def _gap(self, trial: Trial) -> float:
        return float(self.yardstick.gap(trial.held).mean())

    def gap_of(self, trial: Trial) -> float:
        """The gap over both halves: an effect may act so seldom that one half shows nothing of it."""
        return float(np.concatenate([self.yardstick.gap(r) for r in (trial.held, trial.fit.residuals)]).mean())

    def _usual_gap(self, trial: Trial) -> float:
        """The geometric mean over the windows of both halves, in which a few large ones count little."""
        gaps = np.concatenate([self.yardstick.gap(r) for r in (trial.held, trial.fit.residuals)])
        return float(np.exp(np.log(np.maximum(gaps, 1e-300)).mean()))

    def _gain(self, trial: Trial, current: Trial, level: float) -> float:
        """Held-out log density gained per window, where it is sure; else nothing.

        Beside contacts slopes are not asked: noise pushes to one side there, and whatever pushes to the other agrees
        with it. What acts seldom gains in too few blocks to tell; where it leaves no more than noise would, their sum
        counts.
        """
        gain, _, p = self.court.gain(trial, current)
        if self.sigma is None:
            p = min(1.0, 2.0 * (p if 2.0 * p <= level else min(p, self.slope(trial, current))))  # of two tests
        if p > level and likelihood_test(trial.foretold - current.foretold, self.court.block) <= level:
            p = 0.0 if self._closes(trial, current) else p
        return gain if p <= level else 0.0

    def slope(self, trial: Trial, current: Trial) -> float:
        """The p-value of the held-out windows' slope towards a trial, from the place of the model without it."""
        if current not in self.scores:
            self.scores[current] = HeldScore(self.court, current)
            self.count(current.fit.replay)
        return self.scores[current].p_value(trial)

    def given_by_noise(self, trial: Trial, current: Trial, sigma: Array, gain: float) -> bool:
        """Whether noise alone gives a trial as much: a gap near the floor may be noise that was believed too small."""
        noise = self.by_noise.pop(current, None) or NoiseAlone(self.court, current, sigma)
        while len(self.by_noise) > REMEMBERED:
            self.by_noise.pop(next(iter(self.by_noise)))
        self.by_noise[current] = noise
        given = noise.gives(trial, gain)
        self.count(trial.fit.replay, current.fit.replay)
        return given

    def _closes(self, trial: Trial, current: Trial) -> bool:
        """Whether a trial leaves no more than noise would of a gap that is far beyond it."""
        if not self.at_floor(trial):
            return False
        floor = float(self.yardstick.floor.mean())
        left = max(self.gap_of(trial) - floor, FLOOR_ERROR)
        return self.gap_of(current) - floor >= left / (1 - CLOSED)

    def _equal(self, gap: float, best: Trial, trial: Trial, untold: bool) -> bool:
        """Whether a trial explains the same as the best, of a gap, where densities do not tell them apart, or do.

        Beside contacts a few jumps decide about densities: who leaves as little as the best is its equal whatever they
        say, and who leaves much more is not. Nor is who explains next to nothing where the best explains little.
        """
        if self.sigma is None:
            return untold
        left = self.gap_of(best)
        more = self.gap_of(trial) - left
        as_little = more <= min(FLOOR_ERROR * max(left, 1.0), ALIKE * max(gap - left, 0.0))
        return as_little or (untold and self._leaves_nearly(gap, best, trial))

    def _leaves_nearly(self, gap: float, best: Trial, trial: Trial) -> bool:
        """Whether a trial leaves nearly as little of a gap as the best."""
        left = self.gap_of(best)
        return self.gap_of(trial) - left <= (1 - CLOSED) * (gap - left)
