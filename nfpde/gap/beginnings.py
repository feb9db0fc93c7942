"""Searches that begin with another effect, where the likeliest first one led nowhere.

Two faults may together look much like one effect that is neither. Taken first, it leaves little, of which nothing is
the cause; forward selection does not come back from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from nfpde.gap.accepted import Accepted, called
from nfpde.gap.select import MOST_EFFECTS, Selection
from nfpde.gap.trial import APART, LEVEL, Trial

OTHERS = 2
"""Other effects to begin with, at most."""

FAR = 2.0
"""Gap in noise floors from which what was found is taken to have led nowhere."""

WORTHWHILE = 0.5
"""Share of the gap that the first effect removed, which another must remove to begin with."""

Selected = tuple[Trial, list[Accepted]]


def best_beginning(selection: Selection, base: Trial, final: Trial, accepted: list[Accepted]) -> Selected:
    """What was selected, or what the same selection finds that begins with another effect, where that is better.

    Args:
        selection: It knows the candidates of its first round.
        base: The parameters alone.
        final: What was selected.
        accepted: Its effects.
    """
    found = final, accepted
    for begun in other_beginnings(selection, base, final, accepted):
        selection.report(f"searching from {begun.effect.name} on")
        other = selection.run(base, (begun.trial, [begun]), further=True)
        if _better(selection, other, found):
            found = other
    return found


def other_beginnings(selection: Selection, base: Trial, final: Trial, accepted: Sequence[Accepted]) -> list[Accepted]:
    """Effects to begin with, where those found leave much more than noise, or are as many as may be.

    Of the first round, without what was found: what would have been accepted then, again without that and its equals.
    """
    if not accepted:
        return []
    far = selection.gap_of(final) > FAR * float(selection.yardstick.floor.mean()) and not selection.at_floor(final)
    if not far and len(accepted) < MOST_EFFECTS:
        return []
    gap, taken = selection.gap_of(base), {called(a.effect) for a in accepted}
    least = WORTHWHILE * max((gap - selection.gap_of(t) for t in selection.ranking), default=0.0)
    left = [t for t in selection.ranking if t.effect is not None and called(t.effect) not in taken]
    left, out = [t for t in left if gap - selection.gap_of(t) >= least], list[Accepted]()
    while left and len(out) < OTHERS:
        found = selection.accept(base, left, gap)
        if found is None:
            break
        begun = found[1]
        out.append(replace(begun, field=tuple(selection.ranking)))
        left = [t for t in left if t is not begun.trial and t not in begun.rivals]
    return out


def _better(selection: Selection, other: Selected, found: Selected) -> bool:
    """Whether another selection explains more, surely and worth a name, or no less with fewer effects."""
    (trial, effects), (final, accepted) = other, found
    court, gap = selection.court, selection.gap_of
    if court.gain(trial, final)[2] <= LEVEL / OTHERS and selection.shrinks(trial, final, gap(final)):
        return True
    worse = court.gain(final, trial)[2] <= APART or selection.shrinks(final, trial, gap(trial))
    return len(effects) < len(accepted) and not worse
