"""Forward selection of effects, with a second look at the earlier ones, and who cannot be told from whom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.accepted import Accepted, key, parameter_count
from nfpde.gap.bootstrap import NoiseAlone
from nfpde.gap.fit import Fit
from nfpde.gap.levels import FLOOR_ERROR, Yardstick, near_floor
from nfpde.gap.rounds import Rounds
from nfpde.gap.score import HeldScore
from nfpde.gap.trial import (
    APART,
    LEAST_GAIN,
    LEVEL,
    Trial,
    block_test,
    likelihood_test,
    noise_of,
)

Array = NDArray[np.float64]
Chosen = tuple[Trial, Accepted]

MOST_EFFECTS = 3
"""Effects accepted at most."""

WORTH = 0.02
"""Share of the gap that an effect must remove to be named: less is of no use."""

CLOSED = 0.9
"""Share of the gap beyond noise that must be explained for the verdict "effects"; with more left than that, something
else is at work."""

TWIN_TURNS = 3
"""Turns in which effects are looked for that do what the accepted one does, as long as each accepts another."""

NOISE_SEED = 0
"""Of the draws of noise in which a gap may disappear."""

NEGLIGIBLE = 0.005
"""Share of the best effect's gain by which another may fall behind and still count as equal, however sure it is."""


@dataclass(eq=False, kw_only=True)
class Selection(Rounds):
    """Adds effects to a base fit as long as recordings that no fit saw ask for them.

    yardstick: measures the gap
    sigma: noise of the sensors (2 nv,), where contacts decide what becomes of it; else None
    ranking: candidates of the first round
    asked: whether candidates were last refitted beside what is accepted, and none was worth it
    by_noise: what noise alone gives to candidates, by what they are beside
    scores: slopes of the held-out windows, by the model at which they are
    last: whether no longer windows follow
    """

    yardstick: Yardstick
    sigma: Array | None = None
    ranking: list[Trial] = field(default_factory=list)
    asked: bool = False
    by_noise: dict[Trial, NoiseAlone] = field(default_factory=dict)
    scores: dict[Trial, HeldScore] = field(default_factory=dict)
    last: bool = True

    def run(
        self, base: Trial, earlier: tuple[Trial, list[Accepted]] | None = None, *, further: bool = False
    ) -> tuple[Trial, list[Accepted]]:
        """Select.

        Args:
            base: The parameters fitted, without effects.
            earlier: What was found on shorter windows, or in more noise, to go on from.
            further: Ask about what it left, though that was asked about before: in more noise, or of another beginning.

        Returns:
            The final trial and the accepted effects in the order of their acceptance. Without any, it is the base, or
            a better place of the parameters that was found on the way, from which to select anew.
        """
        current, accepted, carried = base, list[Accepted](), list[Accepted]()
        first_gap = self.gap_of(base)
        if earlier is not None and earlier[1]:
            current, accepted = self._carried(base, *earlier, first_gap)
            carried = list(accepted)
        for _ in range(2 * MOST_EFFECTS):  # a second look may take effects away again
            if len(accepted) == MOST_EFFECTS or self._nothing_left(current, accepted):
                break
            known = self.asked and earlier is not None and accepted and not further and not self.last
            if known and self.gap_of(current) <= (1 - CLOSED) * first_gap:
                break  # about what is left, on shorter windows
            self.report(f"screening for effect {len(accepted) + 1}")
            trials = self.refitted(current, [a.effect for a in accepted])
            found = self.accept(current, trials, first_gap)
            idle = None if found is None else self._idle(found[0], current, first_gap)
            if found is not None and idle is None and self._asks_for_twins(found[0]):
                first = found[0]
                trials, found = self._beside_twins(current, found, trials, accepted, first_gap)
                idle = None if found[0] is first else self._idle(found[0], current, first_gap)
            self.ranking, self.asked = self.ranking or trials, found is None
            if found is None:
                break
            if idle is not None:
                if not accepted:
                    return self._linear(idle, fitted=True), []
                current = idle
                continue
            current, new = found
            current = self._converged(current.fit)
            accepted.append(new)
            if len(accepted) > 1:
                current, accepted = self._second_look(current, accepted, first_gap)
        if len(accepted) > 1:
            current, accepted = self._pruned(current, accepted, first_gap, carried)
        return (self._linear(current, fitted=len(accepted) < 2) if accepted else current), accepted

    def _nothing_left(self, current: Trial, accepted: Sequence[Accepted]) -> bool:
        """Whether what is left is not worth a search.

        Beside contacts the floor is known to a factor only: on the last windows what is below it is searched, too.
        """
        if self.sigma is not None and self.last:
            return False
        return self.at_floor(current) if accepted else self.in_noise(current)

    def _asks_for_twins(self, found: Trial) -> bool:
        """Whether another effect may do what the found one does, and better, though screening ranked it low.

        In smooth motion screening sees what does the same alike, unless more than one thing is wrong, or the cause
        has more to it than what screening tries: then the found one leaves something over.
        """
        return self.sigma is not None or not self.at_floor(found)

    def _beside_twins(
        self, current: Trial, found: Chosen, trials: list[Trial], accepted: list[Accepted], first_gap: float
    ) -> tuple[list[Trial], Chosen]:
        """Candidates with those that do what the accepted one does, and again those of what is accepted then."""
        for _ in range(TWIN_TURNS):
            before = key(found[1].effect)
            more = self.twins(current, found[0], trials, [a.effect for a in accepted])
            trials = sorted([*trials, *more], key=lambda t: -float(t.density.mean()))
            found = self.accept(current, trials, first_gap) or found
            if key(found[1].effect) == before:
                break
        return trials, found

    def _pruned(
        self, current: Trial, accepted: list[Accepted], first_gap: float, carried: Sequence[Accepted] = ()
    ) -> tuple[Trial, list[Accepted]]:
        """Without effects that the others have made superfluous.

        Args:
            current: With all of them.
            accepted: In the order of the effects in it.
            first_gap: Of the parameters alone.
            carried: Effects that shorter windows asked for: they stay if these are foretold worse without.
        """
        for index in reversed(range(len(accepted))):
            if len(accepted) == 1:
                break
            smaller = self.without(current, index)
            stays = self.shrinks(current, smaller, first_gap)
            if not stays and accepted[index] in carried:
                stays = self.gap_of(current) < self.gap_of(smaller) and self.court.gain(current, smaller)[0] > 0
            if not stays:
                current, accepted = smaller, [a for i, a in enumerate(accepted) if i != index]
        return current, accepted

    def shrinks(self, trial: Trial, current: Trial, first_gap: float) -> bool:
        """Whether a trial shrinks the gap enough for a name, or that of most windows: a few may be another's work.

        What most windows gain must outweigh, as a factor, what those few lose.
        """
        gap, left = self.gap_of(current), self.gap_of(trial)
        if gap - left >= min(WORTH * first_gap, max(WORTH * gap, FLOOR_ERROR)):
            return True
        usual, usual_left = self._usual_gap(current), self._usual_gap(trial)
        return usual - usual_left >= max(WORTH * usual, FLOOR_ERROR) and left * usual_left < gap * usual

    def _carried(
        self, base: Trial, trial: Trial, accepted: list[Accepted], first_gap: float
    ) -> tuple[Trial, list[Accepted]]:
        """What was found on shorter windows, fitted to these; what was equal there may be told apart here."""
        fit = self.court.fitter.start(trial.fit.replay, trial.fit.xi[None], base.fit.scatter)
        current = self._converged(fit)
        if base.fit.cost - current.fit.cost < LEAST_GAIN:
            return base, []  # the parameters had been stuck on the shorter ones, and do as well alone
        for asked in list(accepted):  # the one told apart stands last afterwards
            current, accepted = self._told_apart(current, accepted, accepted.index(asked), first_gap)
        return current, accepted

    def _told_apart(
        self, current: Trial, accepted: list[Accepted], index: int, first_gap: float
    ) -> tuple[Trial, list[Accepted]]:
        """An effect beside those that did the same on shorter windows, or nearly; it stays where these ask for none.

        Fits to short windows beside contacts may stop on their way, and equals be told apart by where.
        """
        asked = accepted[index]
        others = {key(a.effect) for i, a in enumerate(accepted) if i != index}
        again = {key(t.effect): t for t in (*asked.close, *asked.rivals) if t.effect is not None}
        rivals = [t for name, t in again.items() if name not in others]
        if not rivals:
            return current, accepted
        smaller = self.without(current, index)
        found = self.accept(smaller, self.again(smaller, [asked.trial, *rivals]), first_gap)
        if found is None:
            return current, accepted
        current, new = found
        current, rest = self._converged(current.fit), [a for i, a in enumerate(accepted) if i != index]
        return current, [*rest, replace(new, field=asked.field)]

    def useful(self, base: Trial, trial: Trial, accepted: list[Accepted]) -> tuple[Trial, list[Accepted]]:
        """A trial without effects that make these windows worse; `base` has the parameters alone."""
        found = trial
        while accepted:
            smaller = [self.without(found, i) for i in range(len(accepted))] if len(accepted) > 1 else [base]
            gaps = [self.gap_of(t) for t in smaller]
            index = int(np.argmin(gaps))
            if gaps[index] >= (1 - WORTH) * self.gap_of(found) - FLOOR_ERROR:
                break
            found, accepted = smaller[index], [a for i, a in enumerate(accepted) if i != index]
        return (found if found in (trial, base) else self._linear(found, fitted=True)), accepted

    def _idle(self, trial: Trial, current: Trial, first_gap: float) -> Trial | None:
        """The same place without the last effect, refitted, where that effect does nothing: others had been stuck.

        Beside contacts an effect of next to no size may lead the others from one pit to a deeper one: it does nothing
        where it would not be accepted there, beside the others alone.
        """
        replay = trial.fit.replay
        smaller, keep = self.replay(replay.effects[:-1]), replay.columns(len(replay.effects) - 1).start
        fit = self.court.fitter.start(smaller, trial.fit.xi[:keep][None], trial.fit.scatter)
        self.count(smaller)
        if fit.cost - trial.fit.cost < LEAST_GAIN:
            return self._converged(fit)
        if self.sigma is None or not keep:
            return None
        found = self._converged(fit)
        deeper = self.gap_of(found) < self.gap_of(current)
        return found if deeper and self.accept(found, [trial], first_gap) is None else None

    def _linear(self, trial: Trial, *, fitted: bool) -> Trial:
        """The trial with slopes at its place, after a fit to the end unless it is fitted already."""
        fit = self.court.fitter.linearise(trial.fit if fitted else self.court.converged(trial.fit))
        self.count(fit.replay)
        return self.court.judge(None, fit)

    def at_floor(self, trial: Trial) -> bool:
        """Whether noise alone would leave as much; where contacts are, the floor is known to a factor only."""
        if self.sigma is None:
            return self._gap(trial) < self.floor(trial) + FLOOR_ERROR
        return self.gap_of(trial) < near_floor(self.floor(trial))

    def in_noise(self, base: Trial) -> bool:
        """Whether noise beside contacts leaves as much as there is; in smooth motion a test finds what is below it."""
        return self.sigma is not None and self.gap_of(base) < self.floor(base) + FLOOR_ERROR

    def floor(self, trial: Trial) -> float:
        """The gap that noise alone leaves."""
        floor = float(self.yardstick.floor.mean())
        if self.sigma is None:
            return floor
        # a model that touches nothing knows nothing of what contacts make of noise
        held = self.court.held
        noise = held.quieten(noise_of(trial.fit, self.sigma, held, NOISE_SEED))
        return max(floor, float(np.mean([self.yardstick.gap(draw).mean() for draw in noise])))

    def _gap(self, trial: Trial) -> float:
        return float(self.yardstick.gap(trial.held).mean())

    def gap_of(self, trial: Trial) -> float:
        """The gap over both halves: an effect may act so seldom that one half shows nothing of it."""
        return float(np.concatenate([self.yardstick.gap(r) for r in (trial.held, trial.fit.residuals)]).mean())

    def _usual_gap(self, trial: Trial) -> float:
        """The geometric mean over the windows of both halves, in which a few large ones count little."""
        gaps = np.concatenate([self.yardstick.gap(r) for r in (trial.held, trial.fit.residuals)])
        return float(np.exp(np.log(np.maximum(gaps, 1e-300)).mean()))

    def _converged(self, fit: Fit) -> Trial:
        """A fit brought to its end, so that the next effect does not make up for what is left of the way."""
        fit = self.court.converged(fit)
        self.count(fit.replay)
        return self.court.judge(None, fit)

    def without(self, trial: Trial, index: int) -> Trial:
        """The trial without one of its effects, refitted."""
        replay = trial.fit.replay
        effects = [e for i, e in enumerate(replay.effects) if i != index]
        keep = np.delete(np.arange(replay.nfree), replay.columns(index))
        smaller = self.replay(effects)
        fit = self.court.fitter.start(smaller, trial.fit.xi[keep][None], trial.fit.scatter)
        settled = self.court.settle(fit)
        self.count(smaller)
        return self.court.judge(None, settled)

    def accept(self, current: Trial, trials: Sequence[Trial], first_gap: float) -> Chosen | None:
        """The candidate that the held-out recordings ask for, if they ask for one."""
        gap = self.gap_of(current)
        # what fits the noise better and leaves the gap explains nothing
        worthy = [t for t in trials if self.shrinks(t, current, first_gap)]
        # each is tested at its share of the level: any that passes has been asked for
        gains = {t: g for t in worthy for g in (self._gain(t, current, LEVEL / len(trials)),) if g > 0}
        doubted = self.sigma if gains and gap * (1 - CLOSED) < self.floor(current) else None

        def stands(trial: Trial) -> bool:
            if doubted is None:
                return True
            return not self.given_by_noise(trial, current, doubted, gains[trial] * (1 - CLOSED))

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
            if self._equal(gap, best, trial, apart > APART or trial in near):
                equal.append(trial)
        # within the standard error of the best, the one with fewest parameters
        simplest = sorted((t for t in near if t in gains), key=lambda t: (parameter_count(t), -t.density.mean()))
        chosen = next(t for t in simplest if t is best or stands(t))
        if chosen.effect is None:
            return None
        close = [t for t in beside if self._leaves_nearly(gap, best, t)]
        rivals, others = (tuple(t for t in some if t is not chosen) for some in (equal, close))
        return chosen, Accepted(chosen.effect, chosen, rivals, others, tuple(beside))

    def _gain(self, trial: Trial, current: Trial, level: float) -> float:
        """Held-out log density gained per window, where it is sure; else nothing.

        What acts seldom gains in too few blocks to tell; where it leaves no more than noise would, their sum counts.
        """
        gain, _, p = self.court.gain(trial, current)
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
        if current not in self.by_noise:
            self.by_noise[current] = NoiseAlone(self.court, current, sigma)
        given = self.by_noise[current].gives(trial, gain)
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
        say, and who leaves much more is not.
        """
        if self.sigma is None:
            return untold
        left = self.gap_of(best)
        more = self.gap_of(trial) - left
        return more <= FLOOR_ERROR * max(left, 1.0) or (untold and self._leaves_nearly(gap, best, trial))

    def _leaves_nearly(self, gap: float, best: Trial, trial: Trial) -> bool:
        """Whether a trial leaves nearly as little of a gap as the best."""
        left = self.gap_of(best)
        return self.gap_of(trial) - left <= (1 - CLOSED) * (gap - left)

    def _second_look(self, current: Trial, accepted: list[Accepted], first_gap: float) -> tuple[Trial, list[Accepted]]:
        """Whether an earlier effect still stands, or another takes its place, now that more is explained."""
        for index in range(len(accepted) - 1):
            self.report(f"second look at effect {index + 1}")
            smaller = self.without(current, index)
            others = {key(a.effect) for i, a in enumerate(accepted) if i != index}
            trials = self.again(smaller, [t for t in accepted[index].field if t.effect and key(t.effect) not in others])
            found = self.accept(smaller, trials, first_gap)
            if found is None:
                return smaller, [a for i, a in enumerate(accepted) if i != index]
            replaced, new = found
            if key(new.effect) != key(accepted[index].effect):
                gain = replaced.density - current.density
                if block_test(gain, self.court.block)[2] > APART:
                    if block_test(-gain, self.court.block)[2] > APART:
                        accepted = [a.with_rival(replaced) if i == index else a for i, a in enumerate(accepted)]
                    continue
            # the replacement stands last among the effects now: keep both lists in one order
            accepted = [a for i, a in enumerate(accepted) if i != index] + [new]
            current = replaced
        return current, accepted
