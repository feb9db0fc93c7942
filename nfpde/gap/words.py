"""The diagnosis in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from nfpde.gap.inertia import NAME, is_told, stays
from nfpde.gap.levels import NEAR_FLOOR
from nfpde.gap.report import Cause, Distance, Fitted, Level, Place, ResidualForce, Verdict
from nfpde.gap.written import with_interval

WHEN = {
    "rest": "where it hardly moves",
    "reversal": "where it turns round",
    "slow": "in slow motion",
    "fast": "in fast motion",
    "saturated": "where its drive is at its limit",
    "within limits": "where its drive is within its limits",
    "in contact": "while in contact",
    "contact changes": "where contact is made or lost",
    "in flight": "without contact",
    "early": "early in the recordings",
    "late": "late in the recordings",
}
"""What regimes are, in a sentence."""

_LARGE = 100.0
"""Share from which on powers of ten are written."""

_CLOSE = 0.1
"""Share of the gap that an effect which was not proven must take away to be worth a word."""


def summary(
    verdict: Verdict,
    gap: Level,
    effects: Sequence[Cause],
    where: Sequence[Place],
    base: dict[str, Fitted],
    force: ResidualForce | None,
    apart: Distance,
    ahead: float,
    closest: Cause | None = None,
    computed: str = "",
    encoders: Mapping[str, str] | None = None,
    lone: tuple[int, str] = (0, ""),
) -> list[str]:
    """Sentences that a roboticist can act on; `apart` is the distance of the states `ahead` seconds on.

    `closest` is the effect that would shrink the gap most, proven or not; `computed` says which velocities
    do not count; `encoders` says of joints at rest how they read, as in "0.002 rad too high"; `lone` says how many
    windows alone are far beyond noise, where the mean need not be, and where they are.
    """
    lines = [_first(verdict, gap, lone)]
    if verdict != "no_gap" and where and where[0].share > 0:
        top = where[0]
        lines.append(f"{top.share:.0%} of the gap lies at {top.joint}, most of all {WHEN.get(top.regime, top.regime)}.")
    if base and gap.after_parameters < 0.98 * gap.before and not _is_rounding(gap):
        lines.append(f"Fitting the parameters alone shrinks the gap by {_share(1 - gap.after_parameters, 1)}.")
    lines += [_cause(c) for c in effects]
    lines += [
        f"{c.effect}{_at(c.target)}: {name} leans on the end of what any robot has ({v.value:.4g}{v.behind}): look for "
        "wrong units in the recordings or the model, or for something unknown that it stands in for."
        for c in effects
        for name, v in c.parameters.items()
        if v.at_bound and verdict == "unexplained"
    ]
    if verdict == "unexplained" and not effects and closest is not None and closest.shrink >= _CLOSE:
        lines.append(
            f"Closest comes {closest.effect}{_at(closest.target)}, which would take away {closest.shrink:.0%}; but the "
            "held-out recordings do not bear it out."
        )
    if verdict != "no_gap" and apart.before > apart.noise_floor:
        repaired = f", {apart.after_effects:.2g} with the effects" if effects else ""
        lines.append(
            f"After {ahead:.2g} s the simulated states lie {apart.before:.2g} standard deviations from the recorded "
            f"ones as distributions, {apart.after_parameters:.2g} with the parameters fitted{repaired}; sensor noise "
            f"alone makes {apart.noise_floor:.2g}."
        )
    lines += [
        f"{name} leans on the end of its bounds ({value.value:.4g}{value.behind}): widen them, or doubt the model "
        "there."
        for name, value in base.items()
        if value.at_bound
    ]
    lines += [
        f"The inertia of {name.partition(':')[2]} does not follow the mass ({value.low:.2g} to {value.high:.2g} of the "
        "way): for a fit, set scale_inertia = false in the parameters' file."
        if stays(value.low, value.high)
        else f"The inertia of {name.partition(':')[2]} follows the mass part of the way ({value.low:.2g} to "
        f"{value.high:.2g}): for a fit neither true nor false is right for scale_inertia."
        for name, value in base.items()
        if name.startswith(NAME) and is_told(value.high)
    ]
    if verdict == "unexplained" and force is not None:
        free = f"A free force on {force.joint} of position, speed, command and time would take away"
        lines.append(
            f"None of the known effects explains what is left. {free} {force.share:.0%} of it: look at its picture."
            if force.share >= 0.01
            else f"None of the known effects explains what is left. {free} nothing either: look for what changes "
            "otherwise, such as contact, another joint, noise of the commands, time stamps."
        )
    if computed:
        lines.append(computed)
    lines += [
        f"While it rests, {joint} reads {error}, within half a step of its encoder: that was taken out of the "
        "recordings first."
        for joint, error in (encoders or {}).items()
    ]
    return lines


def _at(target: str) -> str:
    return f" at {target}" if target else ""


def _value(v: Fitted) -> str:
    number, interval = with_interval(v)
    return f"{number}{v.behind} ({interval})"


def _share(value: float, digits: int) -> str:
    """A share in percent, as a power of ten where it is many times the whole."""
    return f"{value:.{digits}%}" if abs(value) < _LARGE else f"{100 * value:.1e}%"


def _is_rounding(gap: Level) -> bool:
    """Whether the nominal model leaves no more than rounding may do."""
    return gap.before < 1


def _first(verdict: Verdict, gap: Level, lone: tuple[int, str]) -> str:
    if verdict == "no_gap" and _is_rounding(gap):
        return "The model reproduces the recordings to rounding: there is no gap to explain."
    if verdict == "no_gap":
        return "The model predicts the recordings as well as their noise allows: there is no gap to explain."
    left = gap.after_effects
    count, places = lone
    windows = f"1 window is far beyond it: {places}" if count == 1 else f"{count} windows are far beyond it: {places}"
    if verdict == "unexplained" and count and left <= NEAR_FLOOR * gap.noise_floor:
        return f"The gap is not explained by any known effect: the mean is within noise, but {windows}."
    floor = f"; sensor noise alone gives {_share(gap.noise_floor, 2)}" if gap.noise_floor > 0 else ""
    if verdict == "effects":
        return f"The gap is explained: {_share(left, 2)} of it is left{floor}."
    alone = f"; {windows}" if count else ""
    return f"The gap is not explained by any known effect: {_share(left, 1)} of it is left{floor}{alone}."


def _cause(c: Cause) -> str:
    values = ", ".join(f"{name} {_value(v)}" for name, v in c.parameters.items())
    share = f"it accounts for {_share(c.shrink, 1)} of the gap"
    if c.shrink <= 0:
        share = "it shows in few windows, none of them among those held out"
    reading = f" (as {c.reading})" if c.reading else ""
    text = f"{c.effect}{_at(c.target)}{reading}: {values}; {share}. {c.sentence}"
    if c.other_readings:
        text += f" It may as well be meant as {', '.join(c.other_readings)}."
    if c.indistinguishable:
        others = ", ".join(f"{r.effect}{_at(r.target)}" for r in c.indistinguishable)
        text += f" These recordings cannot tell it from {others}. {c.separating_experiment}"
    return text
