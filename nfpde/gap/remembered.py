"""Effects of earlier commands that show at the beginnings of episodes alone.

What such an effect does there depends on commands that nobody recorded, and its values are not to be learned there.
That it is there at all is another question: where, by the simplest guess of those commands, it leaves no more than
noise does, it has been told.
"""

from __future__ import annotations

from dataclasses import replace

from nfpde.gap.accepted import Accepted, called, key
from nfpde.gap.found import Found
from nfpde.gap.levels import near_floor


def with_remembered(early: Found, found: Found) -> Found:
    """What was found without windows at the beginnings, and what these told of effects of earlier commands.

    It stays where the beginnings are explained down to their noise, and where recordings that no fit saw, without them,
    are foretold no worse with it. Values come from there. Beside contacts beginnings show what a robot that was let go
    falls on, and the question is not asked.

    Args:
        early: What was found with windows at the beginnings.
        found: Without them.
    """
    selection = found.selection
    if selection.sigma is not None or len(found.accepted) >= selection.most:
        return found
    if not early.selection.gap_of(early.final) < near_floor(early.selection.floor(early.final)):
        return found
    known = {called(t.effect) for a in found.accepted for t in (a.trial, *a.rivals) if t.effect is not None}
    for told in early.accepted:
        effects = [t.effect for t in (told.trial, *told.rivals) if t.effect is not None]
        if told.effect.memory_time() <= 0 or known & {called(e) for e in effects}:
            continue
        again = selection.again(found.final, [told.trial, *told.rivals])
        trials = {key(t.effect): t for t in again if t.effect is not None}
        trial = trials.pop(key(told.effect), None)
        if trial is None or selection.gap_of(trial) >= selection.gap_of(found.final):
            continue
        if selection.court.gain(trial, found.final)[0] <= 0:
            continue
        rivals, field = tuple(trials.values()), (trial, *trials.values())
        new = Accepted(told.effect, trial, rivals, rivals, field)
        return replace(found, final=selection.linear(trial, fitted=False), accepted=[*found.accepted, new])
    return found
