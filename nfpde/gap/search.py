"""The search for effects, from the fit of the parameters alone to what is accepted on the longest windows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset
from nfpde.effects import Effect
from nfpde.gap.accepted import Accepted
from nfpde.gap.beginnings import best_beginning
from nfpde.gap.begins import begins_otherwise
from nfpde.gap.brief import EVERY, MOST, brief, single_steps
from nfpde.gap.far import Far
from nfpde.gap.fit import Fit
from nfpde.gap.found import Earlier, Found, remembers
from nfpde.gap.halves import HeldOut, alike_halves
from nfpde.gap.history import rows_before
from nfpde.gap.recordings import Recordings, cut_recordings, joined
from nfpde.gap.remembered import with_remembered
from nfpde.gap.replay import Replay
from nfpde.gap.select import MOST_EFFECTS, Selection
from nfpde.gap.sensors import sensor_noise
from nfpde.gap.stage import Stage, first_fit, gaps, in_noise, moved_over
from nfpde.gap.telling import asks_again
from nfpde.gap.touching import free_dofs
from nfpde.gap.trial import LEVEL, Court, Trial

Array = NDArray[np.float64]

FAR_MORE = 1.5
"""Times as many windows as were looked at, from which it is worth to look again."""

QUIETER = 0.5
"""Share of the noise that was believed, below which a sensor's is taken for misjudged, and what else is there is asked
again: beside contacts whatever a model lacks looks like noise."""


@dataclass(frozen=True, eq=False)
class Search:
    """Looks for effects.

    start: the nominal model with its free parameters
    dataset: the recordings
    candidates: effects with the values to screen
    guesses: free parameters to start from, the nominal ones first (G, D)
    windows: of each half, at most
    seed: decides which episodes are held out, and all draws
    select: the selection of a stage
    report: called with what is being done
    computed: what velocities that nobody measured take of the positions, see `Differences.weights`
    most: single control steps of each half, at most, where contacts are
    before: what an earlier search leaves to this one
    meets: whether anything touches anything in recorded states
    force: typical generalized forces (nv,)
    swapped: whether the halves have changed places
    """

    start: Replay
    dataset: Dataset
    candidates: Sequence[tuple[Effect, Array]]
    guesses: Array
    windows: int
    seed: int
    select: Callable[[Stage], Selection]
    report: Callable[[str], None]
    computed: Array | None = None
    most: int = MOST
    before: Earlier | None = None
    meets: bool = False
    force: Array | None = None
    swapped: bool = False

    @property
    def touches(self) -> bool:
        """Whether the model can touch the world, or touched itself."""
        return self.meets or any(e.whole == "contact" for e, _ in self.candidates)

    def cut(self, lead: int | None = None, held: HeldOut | None = None) -> Recordings:
        """The recordings in the longest windows.

        Args:
            lead: Rows at an episode's beginning in which none starts; None: as many as a single effect remembers.
            held: What to hold out; None: as the seed decides.
        """
        history, past, rows = self._history()
        lead = rows if lead is None else lead
        most, computed = self.windows, self.computed
        every = cut_recordings(self.dataset, history, self.seed, most, lead, held, past, computed, swapped=self.swapped)
        return replace(every, force=self.force) if self.touches else every

    def run(self) -> tuple[Stage, Found]:
        """What was found, and the stage on which its gap is measured.

        Beside contacts some of the short windows are enough for most faults. Where noise may leave as much as they
        show, or they show nothing, all of them are searched; where these show nothing, joints that touch nothing are
        asked by themselves.
        """
        stage, found = self._to_the_end()
        selection, final = found.selection, found.final
        if found.accepted or selection.spotless(final):
            return stage, found
        if selection.at_floor(final) and not found.every and self._has_more(found.recordings):
            self.report("nothing so far: all short windows")
            search, steps = replace(self, most=EVERY, before=Earlier.of(found)), selection.steps
            del stage, found, selection, final  # which hold much that is not needed any more
            stage, found = search._to_the_end()
            found.selection.steps += steps
        if not found.accepted and found.near is not stage:  # else all joints together were asked over these windows
            found = self._by_free_joints(stage, found)
        return (stage, found) if found.accepted else self._other_way_round(stage, found)

    def _other_way_round(self, stage: Stage, found: Found) -> tuple[Stage, Found]:
        """What the other half finds and this one confirms, where nothing was found in this one and a gap is left.

        One half may know no more of a value than on which side it lies: where nothing slides, friction is enough. What
        is fitted there is any such value, which the other half, in which something slides, refutes.
        """
        selection, final = found.selection, found.final
        if self.swapped or selection.at_floor(final) or (self.touches and not selection.stands_out(final)):
            return stage, found
        self.report("the other half first")
        search, steps = replace(self, swapped=True, before=Earlier.of(found)), selection.steps
        again, other = search._to_the_end()
        selection.steps = other.selection.steps = other.selection.steps + steps
        return (again, other) if other.accepted else (stage, found)

    def _has_more(self, recordings: Recordings) -> bool:
        """Whether there are far more single steps than were looked at."""
        if not self.touches:
            return False
        return single_steps(recordings, EVERY) > FAR_MORE * single_steps(recordings, self.most)

    def _to_the_end(self) -> tuple[Stage, Found]:
        """Search on short windows and long ones."""
        found = self._with_beginnings()
        if found.near.recordings is found.recordings:
            return found.near, found
        return self.over_longest(found)

    def _with_beginnings(self) -> Found:
        """Search without windows at the beginning of episodes, and with them where what was found does not hold there.

        What an effect with a memory does there depends on commands that nobody recorded: where one is found, they tell
        nothing of its values, see `with_remembered`.
        """
        early = self.before is not None and self.before.early
        found = self._run(early=early)
        if early or found.remembers or not self._begin_otherwise(found):
            return found
        self.report("how episodes begin")
        again = self._run(early=True)
        again.selection.steps += found.selection.steps
        if not again.remembers:
            return again
        found.selection.steps = again.selection.steps
        return with_remembered(again, found)

    def _begin_otherwise(self, found: Found) -> bool:
        """Whether what was found does not hold at the beginnings of episodes, as far as these were left out."""
        every, near, lead = self.cut(0), found.near, self._history()[2]
        every = next(r for r in (*self._lengths(every), every) if r.horizons == near.recordings.horizons)
        otherwise = begins_otherwise(found.final, near.sigma, every, lead, near.court.capped, self.seed)
        found.selection.count(found.final.fit.replay)
        return otherwise

    def _run(self, *, early: bool) -> Found:
        """Search with windows at the beginning of episodes or without them.

        What an effect does adds up over longer windows, and so does what wrong starts do beside contacts, where they
        push on average: near the noise all single steps tell more, and more truly, and what these find stands.
        """
        self.report("fitting the parameters")
        held, recordings, base, court = self._begun(early=early)
        lengths = self._lengths(recordings)
        whole = len(lengths) > 1  # single steps have few channels
        self.report("noise of the sensors")
        share = None if self.before is None else self.before.misjudged
        first = in_noise(base, court, lengths[0], self.seed, whole=whole, share=share)
        level = LEVEL if self.before is None else self.before.level
        selection = replace(self.select(first), last=len(lengths) == 1, level=level)
        if self.touches or self.before is not None:
            selection = selection.looking_again()
        if whole:
            selection = replace(selection, far=Far(recordings, court.capped))
        hidden = whole and self.before is None and self._in_noise(first, lengths[-1], selection)
        if hidden:
            self.report("all short windows")
            lengths = brief(recordings, EVERY)
            base, court = moved_over(first.base, court, lengths[0])
            first = in_noise(base, court, lengths[0], self.seed, whole=whole, share=first.misjudged)
            selection = replace(selection.over(first), below=True)
        # what a start's velocity does hangs on what is accepted: where nobody measured it, it is asked anew each time
        unmeasured = recordings.positions_alone
        if unmeasured:
            selection = replace(selection, most=1)
        near, selection, final, accepted = self._select(first, selection)
        if selection.below:  # where these ask for nothing, what adds up shows most in the longest
            lengths = lengths[:1] if accepted else [lengths[0], lengths[-1]]
        if not unmeasured and not (early and remembers(accepted)):  # whose values are not taken from there
            final, accepted = best_beginning(selection, near.base, final, accepted)
        known = 0
        while known < len(accepted) < MOST_EFFECTS:
            known = len(accepted)
            if not unmeasured and not self._may_hide(near, selection, final):
                break
            self.report("noise of the sensors")
            if near is not first:  # the parameters had been stuck
                base, court = moved_over(near.base, court, lengths[0])
            share = near.misjudged
            first = in_noise(base, court, lengths[0], self.seed, final.fit, whole=whole, share=share)
            if not unmeasured and not self._hid(first, selection, final):
                break
            selection = replace(selection, most=known + 1 if unmeasured else MOST_EFFECTS)
            near, selection, final, accepted = self._select(first, selection, (final, accepted), further=True)
            if not whole:  # else what was tried is shown on the longest windows
                selection.ranking[:] = [near.shown(t, refitted=False) for t in selection.ranking]
        if unmeasured:
            selection = replace(selection, most=MOST_EFFECTS)
            if not (early and remembers(accepted)):
                final, accepted = best_beginning(selection, near.base, final, accepted)
        for longer in lengths[1:]:
            self.report("longer windows")
            stage = self.after(near, longer, final.fit if accepted else None)
            selection = replace(selection.looking_again(), last=longer is lengths[-1], below=False)
            near, selection, final, accepted = self._select(stage, selection, (final, accepted))
        return Found(recordings, near, selection, final, accepted, early, halves=held, every=hidden)

    def _begun(self, *, early: bool) -> tuple[HeldOut | None, Recordings, Trial, Court]:
        """What is held out, the longest windows, and the fit to the shortest; see `_run`."""
        lead = 0 if early else None
        if self.before is not None:
            held = self.before.halves
            recordings = self.cut(lead, held)
            known = np.vstack([self.guesses, self.before.xi])
            fitted = first_fit(self.start, self._lengths(recordings)[0], known, capped=self.touches, look=False)
            return held, recordings, *fitted
        recordings = self.cut(lead)
        lengths = self._lengths(recordings)
        base, court = first_fit(self.start, lengths[0], self.guesses, capped=self.touches)
        longest = joined(recordings.fit, recordings.held)
        held = alike_halves(joined(lengths[0].fit, lengths[0].held), gaps(base, court), self.seed, longest)
        if held is not None:
            recordings = self.cut(lead, held)
            base, court = moved_over(base, court, self._lengths(recordings)[0])
        return held, recordings, base, court

    def over_longest(self, found: Found) -> tuple[Stage, Found]:
        """What was found on shorter windows, over the longest ones, and their stage: there the gap is measured.

        Where these tell more of it, they decide. What happens at a joint that touches nothing, short windows may not
        show: where one stands out in long ones, it is asked about there.
        """
        stage = self.after(found.near, found.recordings, found.final.fit if found.accepted else None, look=False)
        final = stage.shown(found.final, refitted=True) if found.accepted else stage.base
        if asks_again(found.selection.over(stage), stage, final, found):
            self.report("the longest windows, which tell more")
            stage, found, final = self._told_by(stage, found, final)
        selection = replace(found.selection, court=stage.court, yardstick=stage.yardstick, far=None)
        selection = replace(selection, by_noise={}, scores={})
        final, accepted = selection.useful(stage.base, final, found.accepted)
        selection.ranking[:] = [stage.shown(t, refitted=False) for t in selection.ranking]
        over = replace(found, selection=selection, final=final, accepted=accepted)
        if selection.stands_out(final):
            self.report("joints that stand out over longer windows")
            asked = replace(selection.looking_again(), last=True, untouched=True)
            near, asked, final, more = self._select(stage, asked, (final, accepted), further=True)
            if len(more) > len(accepted):
                return near, replace(found, near=near, selection=asked, final=final, accepted=more)
            over = replace(over, selection=replace(selection, steps=asked.steps, level=asked.level))
        return stage, over

    def _told_by(self, stage: Stage, found: Found, shown: Trial) -> tuple[Stage, Found, Trial]:
        """What was found as the longest windows have it, and what they ask for beside it; as it was if nothing is left.

        How well values are known is left to the short ones: slopes that are sharper than jumps are far apart would have
        it that long ones know them to a thousandth.
        """
        selection = replace(found.selection.looking_again(), far=None, last=False, below=False)
        by, selection, final, accepted = self._select(stage, selection, (shown, found.accepted))
        found.selection.steps = selection.steps
        if not accepted:
            return stage, found, shown
        return by, replace(found, selection=selection, final=final, accepted=accepted), final

    def _by_free_joints(self, stage: Stage, found: Found) -> Found:
        """What joints that touch nothing ask for over the longest windows, where all joints together ask for nothing.

        Their motion is smooth, and a weak force adds up over it; beside what contacts make of noise at the others it is
        not seen.
        """
        if found.selection.spotless(stage.base):
            return found
        windows = joined(found.recordings.fit, found.recordings.held)
        dofs = free_dofs(self.start.sim.model, windows.state.reshape(-1, windows.state.shape[2]))
        if not len(dofs):
            return found
        self.report("joints that touch nothing")
        by = self.after(stage, found.recordings, None, look=False, dofs=dofs)
        asked = replace(found.selection.looking_again(), last=True, untouched=True, ranking=[])
        by, asked, final, accepted = self._select(by, asked)
        selection = replace(found.selection, steps=asked.steps, level=asked.level)
        found = replace(found, selection=selection)
        if not accepted:
            return found
        shown = stage.shown(final, refitted=True)
        kept, accepted = selection.useful(stage.base, shown, accepted)
        if not accepted:
            return found
        selection.ranking[:] = [stage.shown(t, refitted=False) for t in asked.ranking]
        return replace(found, near=stage, final=kept, accepted=accepted, by=by)

    def _select(
        self,
        near: Stage,
        selection: Selection,
        earlier: tuple[Trial, list[Accepted]] | None = None,
        *,
        further: bool = False,
    ) -> tuple[Stage, Selection, Trial, list[Accepted]]:
        """Select on a stage, and anew from where the parameters got unstuck; see `Selection.run`."""
        selection = selection.over(near)
        final, accepted = selection.run(near.base, earlier, further=further)
        for _ in range(MOST_EFFECTS):
            if accepted or final is near.base:
                break
            near = near.at(final)
            selection = replace(selection.over(near), ranking=[])
            final, accepted = selection.run(near.base, earlier, further=further)
        return near, selection, final, accepted

    def _in_noise(self, first: Stage, longer: Recordings, selection: Selection) -> bool:
        """Whether noise may leave all that single steps and longer windows show, and there is anything at all."""
        if not selection.at_floor(first.base) or selection.spotless(first.base):
            return False
        stage = self.after(first, longer, None)
        return selection.over(stage).at_floor(stage.base)

    def _may_hide(self, near: Stage, selection: Selection, final: Trial) -> bool:
        """Whether noise that was believed too large, without what was found, may have hidden more.

        In smooth motion whatever is above the noise floor has been asked about already.
        """
        if not self.touches:
            return selection.at_floor(final)
        rows, encoders = near.recordings.rows, near.recordings.encoders
        sigma = sensor_noise(final.fit.replay, final.fit.xi, rows, encoders) / near.misjudged
        selection.count(final.fit.replay)
        return bool((sigma < QUIETER * near.sigma).any())

    def _hid(self, anew: Stage, selection: Selection, final: Trial) -> bool:
        """Whether less noise (`anew`) hides less: in smooth motion what was below its floor may be above it now."""
        return self.touches or not selection.over(anew).at_floor(anew.shown(final, refitted=False))

    def after(
        self,
        before: Stage,
        longer: Recordings,
        known: Fit | None,
        *,
        look: bool = True,
        dofs: NDArray[np.intp] | None = None,
    ) -> Stage:
        """The stage of longer windows, its base fitted from the guesses and from that of the shorter ones.

        Args:
            before: The stage of the shorter ones.
            longer: The windows.
            known: What was found there, if anything: it knows more of noise than the base.
            look: Whether parameters are looked for all over their bounds again, where contacts are; windows that decide
                nothing take those of the windows that did.
            dofs: Degrees of freedom that are looked at; None: all.
        """
        fit = before.base.fit
        guesses = np.vstack([self.guesses, fit.xi])
        base, court = first_fit(fit.replay, longer, guesses, capped=True, look=False, dofs=dofs)
        return in_noise(base, court, longer, self.seed, known, share=before.misjudged, look=look)

    def _history(self) -> tuple[int, int, int]:
        """See `rows_before`."""
        return rows_before([e for e, _ in self.candidates], self.dataset.control_dt, self.start.sim, self.touches)

    def _lengths(self, recordings: Recordings) -> list[Recordings]:
        """The recordings in windows of the lengths that are fitted, shortest first."""
        return (brief(recordings, self.most) if self.touches else []) or [recordings]
