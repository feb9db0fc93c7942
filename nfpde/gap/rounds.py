"""Candidates for the next effect, refitted beside what is there."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.effects import Effect
from nfpde.gap.accepted import called, key
from nfpde.gap.fit import Fit
from nfpde.gap.recall import Recall
from nfpde.gap.refit import refit
from nfpde.gap.replay import Replay
from nfpde.gap.rounding import is_rounding
from nfpde.gap.screen import Screened, screen
from nfpde.gap.trial import GLANCED, LEAST_GAIN, MOST_SCREENED, SCREENED, Court, Trial
from nfpde.gap.twins import find_twins
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device

Array = NDArray[np.float64]


@dataclass(eq=False)
class Rounds:
    """Refits candidates, and counts what that takes.

    model, space, nthread, device: of the simulator
    court: refits and judges
    candidates: effects with the values to screen
    report: called with what is being done
    recall: what replays of the model have predicted
    steps: simulated so far
    untouched: whether it is asked about joints that touch nothing: slopes foretell what happens there, and what
        contacts do is no candidate
    """

    model: mujoco.MjModel
    space: ParameterSpace | None
    nthread: int
    court: Court
    candidates: Sequence[tuple[Effect, Array]]
    report: Callable[[str], None] = lambda what: None
    device: Device = "cpu"
    recall: Recall = field(default_factory=Recall)
    steps: int = 0
    untouched: bool = False

    def refitted(self, current: Trial, taken: Sequence[Effect]) -> list[Trial]:
        """The candidates that screening likes, refitted beside what is there; most held-out density first."""
        base = self.court.fitter.linearise(current.fit)
        open_ones = self._open(taken)
        replay_with, replays = self._beside(base)
        if len(open_ones) > MOST_SCREENED:
            glanced = self._screen(base, open_ones, replay_with, GLANCED)
            # what contacts do is searched for anyway, see `refit`
            kept = glanced[:MOST_SCREENED] + [s for s in glanced[MOST_SCREENED:] if s.effect.whole == "contact"]
            open_ones = [(s.effect, s.values) for s in kept]
        screened = self._screen(base, open_ones, replay_with, SCREENED)
        self.report(f"refitting with effect {len(taken) + 1}")
        trials = self._refit(base, screened)
        self._end(replays)
        return trials

    def twins(self, current: Trial, found: Trial, trials: Sequence[Trial], taken: Sequence[Effect]) -> list[Trial]:
        """Effects that do the same as one that was found, refitted, where they were not."""
        base = self.court.fitter.linearise(current.fit)
        known = {key(t.effect) for t in trials if t.effect is not None}
        replay_with, replays = self._beside(base)
        twins = find_twins(self.court, base, found, self._open(taken, known), replay_with, touches=self._touches)
        more = self._refit(base, twins)
        self._end(replays)
        return more

    def again(self, smaller: Trial, trials: Sequence[Trial]) -> list[Trial]:
        """Effects that were refitted before, beside another base, from where they were."""
        base = self.court.fitter.linearise(smaller.fit)
        hopeful = []
        for t in trials:
            if t.effect is not None:
                columns = t.fit.replay.columns(len(t.fit.replay.effects) - 1)
                replay, values = self.replay([*base.replay.effects, t.effect]), t.fit.xi[columns][None]
                starts = ((base.scatter, values),)
                hopeful.append(Screened(t.effect, replay, values, (1.0,), 1.0, starts))
        found = self._refit(base, hopeful)
        self._end([s.replay for s in hopeful])
        return found

    def _open(self, taken: Sequence[Effect], known: Collection[tuple[str, str]] = ()) -> list[tuple[Effect, Array]]:
        """The candidates beside those that are taken, however these are read, and those that are known."""
        names = {called(e) for e in taken}
        asked = [(e, values) for e, values in self.candidates if called(e) not in names and key(e) not in known]
        return [(e, values) for e, values in asked if e.whole != "contact"] if self.untouched else asked

    def _refit(self, base: Fit, screened: Sequence[Screened]) -> list[Trial]:
        """Candidates refitted, but those that do what encoders round away."""
        windows, encoders = self.court.fitter.windows, self.court.encoders
        trials = refit(self.court, base, screened, touches=self._touches)
        return [t for t in trials if t.effect is None or not is_rounding(t.effect, t.fit, windows, encoders)]

    @property
    def _touches(self) -> bool:
        """Whether contacts have a part in what is asked about."""
        return self.court.capped > 0 and not self.untouched

    def _screen(
        self,
        base: Fit,
        candidates: Sequence[tuple[Effect, Array]],
        replay_with: Callable[[Effect], Replay],
        part: tuple[int, float],
    ) -> list[Screened]:
        court = self.court
        least = 0.0 if part is GLANCED else LEAST_GAIN  # a glance is at too few windows to tell
        touches = self._touches
        return screen(*court.screening(base, part), candidates, replay_with, court.quiet, least, touches=touches)

    def _beside(self, base: Fit) -> tuple[Callable[[Effect], Replay], list[Replay]]:
        """What makes the replay of a base and one more effect, and those that it made."""
        made: list[Replay] = []

        def replay_with(effect: Effect) -> Replay:
            if made:  # they are simulated one after the other: what a hundred hold is gigabytes
                made[-1].sim.release()
            made.append(self.replay([*base.replay.effects, effect]))
            return made[-1]

        return replay_with, made

    def replay(self, effects: Sequence[Effect]) -> Replay:
        """The model with effects."""
        return Replay(self.model, self.space, effects, self.nthread, self.device, self.recall)

    def _end(self, replays: Sequence[Replay]) -> None:
        """Count the steps of replays that are not asked again soon, and give back what they hold."""
        self.count(*replays)
        for replay in replays:
            replay.sim.release()

    def count(self, *replays: Replay) -> None:
        """Add the steps that replays simulated."""
        for replay in replays:
            self.steps += replay.sim.simulated_steps
            replay.sim.simulated_steps = 0
