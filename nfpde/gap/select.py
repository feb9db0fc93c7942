"""Forward selection of effects, with a second look at the earlier ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.acceptance import CLOSED, WORTH, Acceptance, Chosen
from nfpde.gap.accepted import Accepted, called, key
from nfpde.gap.fit import Fit
from nfpde.gap.funnel import down_the_funnel
from nfpde.gap.levels import FLOOR_ERROR
from nfpde.gap.stage import Stage
from nfpde.gap.trial import APART, LEAST_GAIN, Trial, block_test

Array = NDArray[np.float64]

MOST_EFFECTS = 3
"""Effects accepted at most."""

TWIN_TURNS = 3
"""Turns in which effects are looked for that do what the accepted one does, as long as each accepts another."""


@dataclass(eq=False, kw_only=True)
class Selection(Acceptance):
    """Adds effects to a base fit as long as recordings that no fit saw ask for them.

    ranking: candidates of the first round
    most: effects accepted at most
    asked: whether candidates were last refitted beside what is accepted, and none was worth it
    """

    ranking: list[Trial] = field(default_factory=list)
    most: int = MOST_EFFECTS
    asked: bool = False

    def looking_again(self) -> Selection:
        """For another look at the recordings: each has half the level of the one before, all together one."""
        return replace(self, level=self.level / 2)

    def over(self, near: Stage) -> Selection:
        """On another stage: it knows nothing of what was asked about on the one before."""
        sigma = None if self.sigma is None else near.sigma
        return replace(self, court=near.court, yardstick=near.yardstick, sigma=sigma, by_noise={}, scores={})

    def run(
        self, base: Trial, earlier: tuple[Trial, list[Accepted]] | None = None, *, further: bool = False
    ) -> tuple[Trial, list[Accepted]]:
        """Select.

        Args:
            base: The parameters fitted, without effects.
            earlier: What was found on shorter windows, or in more noise, to go on from; on these, if untouched.
            further: Ask about what it left, though that was asked about before: in more noise, or of another beginning.

        Returns:
            The final trial and the accepted effects in the order of their acceptance. Without any, it is the base, or
            a better place of the parameters that was found on the way, from which to select anew.
        """
        current, accepted, carried = base, list[Accepted](), list[Accepted]()
        first_gap = self.gap_of(base)
        if earlier is not None and earlier[1]:
            if self.untouched:  # what contacts do is asked of short windows
                current, accepted = earlier[0], list(earlier[1])
            else:
                current, accepted = self._carried(base, *earlier, first_gap)
            carried = list(accepted)
        for _ in range(2 * MOST_EFFECTS):  # a second look may take effects away again
            if len(accepted) >= self.most or self._nothing_left(current, accepted):
                break
            known = self.asked and earlier is not None and accepted and not further and not self.last
            if known and self.gap_of(current) <= (1 - CLOSED) * first_gap:
                break  # about what is left, on shorter windows
            self.report(f"screening for effect {len(accepted) + 1}")
            trials = self.refitted(current, [a.effect for a in accepted])
            found = self.accept(current, trials, first_gap, self.level)
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
                    return self.linear(idle, fitted=True), []
                current = idle
                continue
            current, new = found
            current = self._converged(current.fit)
            accepted.append(new)
            if len(accepted) > 1 and not self.untouched:
                current, accepted = self._second_look(current, accepted, first_gap)
        if len(accepted) > 1:
            current, accepted = self._pruned(current, accepted, first_gap, carried)
        return (self.linear(current, fitted=len(accepted) < 2) if accepted else current), accepted

    def _nothing_left(self, current: Trial, accepted: Sequence[Accepted]) -> bool:
        """Whether what is left is not worth a search.

        Beside contacts the floor is known to a factor only: what is below it is searched, too, on the last windows,
        where all single steps are looked at, and for a second effect, as no others are looked at for one.
        """
        if self.sigma is not None and self.spotless(current):
            return True
        if self.untouched:
            return bool(accepted) and not self.stands_out(current)
        if self.sigma is None:
            return bool(accepted) and self.at_floor(current)
        if self.last or len(accepted) == 1:
            return False
        return self.at_floor(current) if accepted else not self.below and self.in_noise(current)

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
            found = self.accept(current, trials, first_gap, self.level) or found
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
        others = {called(a.effect) for i, a in enumerate(accepted) if i != index}
        again = {key(t.effect): t for t in (*asked.close, *asked.rivals) if t.effect is not None}
        rivals = [t for t in again.values() if t.effect is not None and called(t.effect) not in others]
        if not rivals:
            return current, accepted
        smaller = self.without(current, index)
        refitted = self.again(smaller, [asked.trial, *rivals])
        found = self.accept(smaller, refitted, first_gap, settled=key(asked.effect))
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
        return (found if found in (trial, base) else self.linear(found, fitted=True)), accepted

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
        deeper = current.fit.cost - found.fit.cost >= LEAST_GAIN and self.gap_of(found) < self.gap_of(current)
        return found if deeper and self.accept(found, [trial], first_gap) is None else None

    def linear(self, trial: Trial, *, fitted: bool) -> Trial:
        """The trial with slopes at its place, after a fit to the end unless it is fitted already."""
        fit = self.court.fitter.linearise(trial.fit if fitted else self.court.converged(trial.fit))
        self.count(fit.replay)
        return self.court.judge(None, fit)

    def _converged(self, fit: Fit) -> Trial:
        """A fit brought to its end, so that the next effect does not make up for what is left of the way."""
        fit = self.court.converged(fit)
        if self.sigma is not None and not self.untouched:
            fit = down_the_funnel(self.court, fit)
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

    def _second_look(self, current: Trial, accepted: list[Accepted], first_gap: float) -> tuple[Trial, list[Accepted]]:
        """Whether an earlier effect still stands, or another takes its place, now that more is explained."""
        for number, name in enumerate([key(a.effect) for a in accepted[:-1]], 1):
            self.report(f"second look at effect {number}")
            index = [key(a.effect) for a in accepted].index(name)  # one that stands goes to the end
            smaller = self.without(current, index)
            others = {called(a.effect) for i, a in enumerate(accepted) if i != index}
            field = [t for t in accepted[index].field if t.effect and called(t.effect) not in others]
            trials = self.again(smaller, field)
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
