"""What to beware of in a result, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import chi2

from nfpde.elements import listed
from nfpde.errors import BadDataset
from nfpde.estimation.trajectory.freedom import FEWEST, widening
from nfpde.estimation.trajectory.noise import Scatter
from nfpde.estimation.trajectory.problem import Problem

WIDER = 1.1
"""Factor on intervals from which it is said that few windows tell the noise."""

CHANCE = 0.01
"""Probability that parameters which explain nothing gain as much by chance."""

MOSTLY, NOTICED = 0.5, 0.01
"""Share of what is left in a channel, and of what it changes by in a window, from which on errors of the simulation are
spoken of."""

WORST = 3
"""Channels that are named."""


def check_noise(problem: Problem, scatter: Scatter) -> None:
    """Refuse recordings of which the parameters explain all, so that nothing says how large the noise is.

    Args:
        problem: windows sorted by robot.
        scatter: the learned noise.

    Raises:
        BadDataset: fewer degrees of freedom are left than one, which the variance of a single number has, and nobody
            has said how exact the sensors of every channel are.
    """
    # velocities computed from positions are not believed, whatever their errors are
    unknown = (problem.grain == 0) & ~problem.computed
    if scatter.freedom >= FEWEST or not unknown.any():
        return
    missing = ""
    if problem.grain.any():
        channels = problem.simulator.states.channels
        missing = f" of {listed([c for c, yes in zip(channels, unknown, strict=True) if yes])}, too"
    count, horizon, robots = len(problem.windows), problem.windows.horizon, len(problem.names)
    raise BadDataset(
        f"{count} window{'s' if count > 1 else ''} of {horizon} control step{'s' if horizon > 1 else ''} "
        f"cannot tell the noise from the {len(problem.simulator.space)} parameters of {robots} "
        f"robot{'s' if robots > 1 else ''}, which can explain all that they show: record more, give the episodes of "
        f"one robot the same label, leave parameters out, or say how exact the sensors{missing} are (resolution)"
    )


def cautions(
    problem: Problem,
    scatter: Scatter,
    errors: Mapping[str, Mapping[str, float]],
    told: Sequence[int],
    *,
    loose: bool = False,
) -> list[str]:
    """Sentences on what makes this result weaker than its numbers look; none where nothing does.

    Args:
        problem: windows sorted by robot.
        scatter: the learned noise.
        errors: of every channel, see `channel_errors`.
        told: number of robots that tell each parameter.
        loose: whether the velocities were found to be worse than none.
    """
    found = []
    if loose:
        found.append(
            "The recorded velocities foretell the positions worse than no velocities do, as those do that were "
            "filtered, delayed or computed from positions: they are not believed, and the positions tell all."
        )
    elif problem.computed.any():
        names = [c for c, computed in zip(problem.simulator.states.channels, problem.computed, strict=True) if computed]
        found.append(
            f"{', '.join(names)}: computed from positions, which tell all that such velocities do; these count next "
            "to nothing here."
        )
    wider = float(np.sqrt(widening(scatter.freedom)))
    if wider >= WIDER:
        found.append(
            f"Few windows tell the noise, to about {scatter.freedom:.2g} degrees of freedom: all intervals are "
            f"{wider:.2g} times as wide as they would be were it known. Record more."
        )
    if not any(told) and no_better(errors, len(problem.windows), len(told) * len(problem.names)):
        found.append(
            "No parameter is told, and the recordings are explained no better than by the middle of the bounds. Either "
            "they say nothing of these parameters, or the search began too far from them: narrow the bounds, or raise "
            "starts."
        )
    elif wider < WIDER and (missing := simulation_share(problem, errors)):  # few windows tell neither
        worst = sorted(missing, key=lambda name: -missing[name])[:WORST]
        found.append(
            "Something is missing in the model that no parameter makes up for: what a control step of the simulation "
            f"lacks is {listed([f'{missing[name]:.0%} of what is left in {name}' for name in worst])}. Parameters may "
            "be off by more than their intervals say; nfpde diagnose looks for what is missing."
        )
    return found


def simulation_share(problem: Problem, errors: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Share of the squares left in each channel that errors of the simulation make, where it is most and matters.

    Args:
        problem: windows sorted by robot.
        errors: of every channel, see `channel_errors`.
    """
    unit = problem.unit[-len(errors) :]
    large = {c: e["simulation"] > NOTICED * u for (c, e), u in zip(errors.items(), unit, strict=True)}
    shares = {
        c: min(1.0, (e["simulation"] / e["after"]) ** 2) for c, e in errors.items() if e["after"] > 0 and large[c]
    }
    return {c: share for c, share in shares.items() if share > MOSTLY}


def no_better(errors: Mapping[str, Mapping[str, float]], windows: int, parameters: int) -> bool:
    """Whether no channel's error has fallen by more than so many parameters gain by chance (Wilks).

    Args:
        errors: root mean square error of every channel, `before` and `after` the fit.
        windows: how many they are the mean of.
        parameters: fitted, in all.
    """
    worth = float(chi2.isf(CHANCE, parameters))
    moved = [e for e in errors.values() if e["before"] > 0 and e["after"] > 0]
    return all(2 * windows * np.log(e["before"] / e["after"]) < worth for e in moved)
