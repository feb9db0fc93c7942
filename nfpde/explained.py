"""From a diagnosis to the next fit: the free parameters, with those of the effects that were found."""

from __future__ import annotations

from dataclasses import replace

from nfpde.effects import Effect
from nfpde.errors import BadInput
from nfpde.gap import Cause, GapReport
from nfpde.gap.inertia import NAME as INERTIA
from nfpde.gap.inertia import inertia_of, stays
from nfpde.nearby import effect_near
from nfpde.parameters import Parameter, ParameterSpace


def explained_space(report: GapReport, space: ParameterSpace | None = None) -> ParameterSpace:
    """The parameters that a fit should vary once the gap is explained.

    Those that were free stay as they are, but for masses whose inertia was found not to follow them
    (`scale_inertia=False`). Behind them come the parameters of the effects found, in the reading that fits, with bounds
    around the fitted values (`nfpde.nearby.bounds_near`): other robots of the kind may have half or one and a half
    times as much of the effect. Of effects that these recordings cannot tell apart it is the one named first.

    Args:
        report: What `diagnose_gap` returned.
        space: The free parameters it was given.

    Returns:
        A space for `MujocoSimulator`, `fit`, and through the fitted distribution for `nfpde.rl.train_sac`;
        `to_toml` writes it for the command line.

    Raises:
        BadInput: A gap remains that no known effect explains: what was found before giving up may stand in for
            something else. Or there is neither an effect nor a free parameter, or the space is not the diagnosis's.
        BadEffect: One of the effects is not registered here.
    """
    if report.verdict == "unexplained":
        raise BadInput(
            "the diagnosis leaves a gap that no known effect explains; what it found before may stand in for something "
            "else, and no fit should take it for granted. Register an effect of your own, or fit without"
        )
    lacking = [
        name for name in report.base if not name.startswith(INERTIA) and name not in (space.names if space else ())
    ]
    if lacking:
        raise BadInput(
            f"the diagnosis had free parameters that the space lacks: {', '.join(lacking)}; give the space it was given"
        )
    own = [] if space is None else _masses_told(report, space)
    found = [p for cause in report.effects for p in _effect_of(report, cause).parameters]
    if not own and not found:
        raise BadInput("the diagnosis found no effect, and no parameter was free: there is nothing to fit")
    return ParameterSpace([*own, *found])


def _effect_of(report: GapReport, cause: Cause) -> Effect:
    values = {key: v.value for key, v in cause.parameters.items()}
    spans = {key: max(v.high - v.value, v.value - v.low) for key, v in cause.parameters.items()}
    return effect_near(report.model, cause.reading or cause.effect, cause.target, values, spans)


def _masses_told(report: GapReport, space: ParameterSpace) -> list[Parameter]:
    """The free parameters, of masses with what was found of their inertia."""
    told = {p: report.base.get(e.parameters[0].name) for p, e in inertia_of(report.model, space).items()}
    alone = {p for p, share in told.items() if share is not None and stays(share.low, share.high)}
    return [replace(p, scale_inertia=False) if p in alone else p for p in space]
