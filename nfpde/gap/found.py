"""What a search found, and what it leaves to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.acceptance import WORTH
from nfpde.gap.accepted import Accepted
from nfpde.gap.certainty import INTERVAL, standard_errors
from nfpde.gap.halves import HeldOut
from nfpde.gap.levels import shrink_interval
from nfpde.gap.recordings import Recordings, blocks_of
from nfpde.gap.select import Selection
from nfpde.gap.stage import Stage
from nfpde.gap.trial import Trial

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found.

    recordings: in the longest windows
    near: the stage of the last selection
    selection: that selection, with the simulated steps of all
    final: the parameters and what was accepted
    accepted: effects in the order of their acceptance
    early: whether windows start in the first rows of episodes, too
    by: the stage of a part of the joints, where these alone told what was found
    halves: what was held out; None where the seed decided
    every: whether all short windows were looked at
    """

    recordings: Recordings
    near: Stage
    selection: Selection
    final: Trial
    accepted: list[Accepted]
    early: bool
    by: Stage | None = None
    halves: HeldOut | None = None
    every: bool = False

    @property
    def remembers(self) -> bool:
        """Whether an accepted effect acts by commands from before a window."""
        return remembers(self.accepted)

    @property
    def doubtful(self) -> bool:
        """Whether there is anything to tell apart: others do nearly the same, or one may make up for another."""
        return len(self.accepted) > 1 or any(a.rivals or a.close for a in self.accepted)


@dataclass(frozen=True, eq=False)
class Earlier:
    """What a search over all short windows takes from the one over some of them.

    halves: what was held out: what was asked of one pair of halves must not be asked of another until chance says yes
    early: whether windows start in the first rows of episodes, too
    misjudged: by how much the noise of the sensors is, see `Stage`
    xi: the fitted parameters, which were looked for all over their bounds (D,)
    level: of its last look, see `Acceptance`
    """

    halves: HeldOut | None
    early: bool
    misjudged: Array | float
    xi: Array
    level: float

    @classmethod
    def of(cls, found: Found) -> Earlier:
        """Of a search that found nothing."""
        return cls(found.halves, found.early, found.near.misjudged, found.near.base.fit.xi, found.selection.level)


def surely(stage: Stage, found: Found, seed: int) -> Found:
    """What was found, or nothing where it is not sure that less of the gap is left with it than without.

    Beside contacts what noise does to densities is known by simulation only, as far as its model holds; a fault that
    has an effect of any size has one on the gap. Windows of both halves count, as it may act in few of them. Where that
    is not surely worth a name, its values must differ surely from none at all. What joints that touch nothing told
    alone adds up in all of them: there it must be sure in the half that no fit saw, in which it must not surely leave
    more of all joints.

    Args:
        stage: The windows on which the gap is measured.
        found: On them.
        seed: Of the draws of blocks.
    """
    if found.selection.sigma is None or not found.accepted:
        return found

    def shrinks(at: Stage, after: Trial, *, both: bool) -> tuple[float, float]:
        """The interval of the share of the gap that is gone."""
        gaps, block = [at.yardstick.gap(t.held) for t in (at.base, after)], at.recordings.block
        if both:
            more = [at.yardstick.gap(t.fit.residuals) for t in (at.base, after)]
            gaps = [np.concatenate(halves) for halves in zip(gaps, more, strict=True)]
            block = np.concatenate([block, -1 - blocks_of(at.recordings.fit)])
        return shrink_interval(gaps[0], gaps[1], block, seed)[1:]

    if found.by is None:
        least = shrinks(stage, found.final, both=True)[0]
        stands = least >= WORTH or (least > 0 and _differs(found))
    else:
        there = found.by.shown(found.final, refitted=False)
        stands = shrinks(found.by, there, both=False)[0] > 0 and shrinks(stage, found.final, both=False)[1] >= 0
    return found if stands else replace(found, final=stage.base, accepted=[], by=None)


def _differs(found: Found) -> bool:
    """Whether of every accepted effect a value differs from where it does nothing by more than its 95 % interval.

    A limit does nothing beyond its bounds: there it is the end of these that counts.
    """
    court = found.near.court
    fit = court.fitter.resolved(found.near.shown(found.final, refitted=False).fit)
    errors, replay = standard_errors(court, fit), fit.replay
    return all(
        any(
            abs(fit.xi[at] - np.clip(quantity.neutral, bounds.low, bounds.high)) > INTERVAL * errors[at]
            for at, (quantity, bounds) in enumerate(
                zip(effect.quantities, effect.parameters, strict=True), replay.columns(i).start
            )
            if not quantity.shape_only
        )
        for i, effect in enumerate(replay.effects)
    )


def remembers(accepted: Sequence[Accepted]) -> bool:
    """Whether an effect acts by commands from before a window."""
    return any(a.effect.memory_time() > 0 for a in accepted)
