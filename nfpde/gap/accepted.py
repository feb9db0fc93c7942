"""Effects that were accepted, and what they cannot be told from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from nfpde.effects import Effect
from nfpde.gap.fit import Fit
from nfpde.gap.trial import Trial


@dataclass(frozen=True, eq=False)
class Accepted:
    """An accepted effect and those it cannot be told from.

    effect: the effect
    trial: it and everything accepted before, when it was accepted
    rivals: other effects that explain the same there, or later, beside more that was accepted; see `beside`
    close: that left nearly as little of the gap there, told apart or not
    field: all that were refitted there, it included
    """

    effect: Effect
    trial: Trial
    rivals: tuple[Trial, ...]
    close: tuple[Trial, ...]
    field: tuple[Trial, ...]

    def with_rival(self, trial: Trial) -> Accepted:
        """The same with another effect that it cannot be told from, each once."""
        known = {key(t.effect) for t in self.rivals if t.effect is not None}
        new = trial.effect is not None and key(trial.effect) not in known
        return replace(self, rivals=(*self.rivals, trial)) if new else self


def key(effect: Effect) -> tuple[str, str]:
    """Name and place, of each reading of an effect its own."""
    return effect.name, effect.place


def beside(fit: Fit) -> frozenset[tuple[str, str]]:
    """The effects that the last one of a fit stands beside."""
    return frozenset(key(effect) for effect in fit.replay.effects[:-1])


def called(effect: Effect) -> tuple[str, str]:
    """Name and place in reports, the same for all readings of an effect."""
    return effect.called, effect.place


def parameter_count(trial: Trial) -> int:
    """Parameters that a trial's effect adds."""
    return len(trial.effect.parameters) if trial.effect is not None else 0


def simplest_first(alike: Sequence[Trial]) -> list[Trial]:
    """Trials that do equally well: fewest parameters first, then most held-out density, of readings the plain one."""
    density = dict[tuple[str, str] | None, float]()
    names = [None if t.effect is None else called(t.effect) for t in alike]
    for name, trial in zip(names, alike, strict=True):
        density[name] = max(density.get(name, -math.inf), float(trial.density.mean()))
    keys = [
        (parameter_count(t), -density[name], bool(t.effect and t.effect.says), -float(t.density.mean()))
        for name, t in zip(names, alike, strict=True)
    ]
    return [alike[i] for i in sorted(range(len(alike)), key=keys.__getitem__)]
