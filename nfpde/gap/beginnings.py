"""Searches that begin with another effect, where the likeliest first one led nowhere.

Two faults may together look much like one effect that is neither. Taken first, it leaves little, of which nothing is
the cause; forward selection does not come back from there.
"""

from __future__ import annotations

from collections.abc import Sequence

from nfpde.gap.accepted import Accepted, key
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
    for trial in other_beginnings(selection, base, final, accepted):
        if trial.effect is None:
            continue
        selection.report(f"searching from {trial.effect.name} on")
        begun = Accepted(trial.effect, trial, (), tuple(selection.ranking))
        other = selection.run(base, (trial, [begun]), further=True)
        if _better(selection, other, found):
            found = other
    return found


def other_beginnings(selection: Selection, base: Trial, final: Trial, accepted: Sequence[Accepted]) -> list[Trial]:
    """Effects to begin with, where those found leave much more than noise, or are as many as may be."""
    if not accepted:
        return []
    far = selection.gap_of(final) > FAR * float(selection.yardstick.floor.mean()) and not selection.at_floor(final)
    if not far and len(accepted) < MOST_EFFECTS:
        return []
    gap, taken = selection.gap_of(base), {key(a.effect) for a in accepted}
    removed = {id(t): gap - selection.gap_of(t) for t in selection.ranking}
    least = WORTHWHILE * max(removed.values(), default=0.0)
    others = [t for t in selection.ranking if t.effect is not None and key(t.effect) not in taken]
    others = [t for t in others if removed[id(t)] >= least and selection.court.gain(t, base)[2] <= LEVEL / len(others)]
    return others[:OTHERS]


def _better(selection: Selection, other: Selected, found: Selected) -> bool:
    """Whether another selection explains more, surely and worth a name, or no less with fewer effects."""
    (trial, effects), (final, accepted) = other, found
    court, gap = selection.court, selection.gap_of
    if court.gain(trial, final)[2] <= LEVEL / OTHERS and selection.shrinks(trial, final, gap(final)):
        return True
    worse = court.gain(final, trial)[2] <= APART or selection.shrinks(final, trial, gap(trial))
    return len(effects) < len(accepted) and not worse
