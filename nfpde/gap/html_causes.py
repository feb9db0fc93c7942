"""The ladder from the nominal model to the noise floor, the ranked causes, and what cannot be told apart."""

from __future__ import annotations

import math
from collections.abc import Sequence

from nfpde.gap.html_svg import number, percent, table, text
from nfpde.gap.report import Cause, Fitted, GapReport, Level
from nfpde.gap.written import with_interval

_FIRST = 10
"""Causes shown at once; the others unfold."""


_ABOVE = 1.0
"""Powers of ten above the nominal model's gap that a scale shows, at most."""


def called(effect: str, target: str) -> str:
    """An effect and where it acts, as plain text."""
    return f"{effect} at {target}" if target else effect


def scale(values: Sequence[float]) -> tuple[float, float]:
    """Ends of a logarithmic scale, as powers of ten: a decade or more, where the smallest value still has a bar.

    What is more than a decade above the nominal model's, at 1, is cut off: beside it nothing else would be told apart.
    """
    logs = [math.log10(v) for v in values if math.isfinite(v) and v > 0] or [0.0]
    low, high = min(min(logs), _ABOVE), min(max(max(logs), 0.0), _ABOVE)
    low = max(low - 0.12 * max(high - low, 1.0), high - 9)
    return min(low, high - 1.1), high


def powers(low: float, high: float) -> list[float]:
    """Round values between the ends of a scale: powers of ten, every second or third one on a long scale."""
    step = max(1, math.ceil((high - low) / 4.5))
    return [10.0**e for e in range(math.floor(high + 1e-9), math.ceil(low) - 1, -step)][::-1]


def ladder(report: GapReport) -> str:
    """The gap at each rung, as bars on a logarithmic scale."""
    low, high = scale([v for _, v in report.ladder])
    out = []
    ticks = powers(low, high)
    lines = "".join(f'<u style="left:{_along(t, low, high):.1f}%"></u>' for t in ticks)
    for i, (label, value) in enumerate(report.ladder):
        kind = " floor" if i == len(report.ladder) - 1 else " start" if i == 0 else ""
        width = _along(value, low, high)
        out.append(
            f'<div class="label">{text(label)}</div><div class="track{kind}"><i style="width:{width:.1f}%"></i>{lines}'
            f'</div><div class="value">{percent(value)}</div>'
        )
    axis = "".join(f'<span style="left:{_along(t, low, high):.1f}%">{percent(t)}</span>' for t in ticks)
    out.append(f'<div class="gone"></div><div class="axis">{axis}</div><div class="gone"></div>')
    return (
        f'<div class="ladder">{"".join(out)}</div><p class="small soft">Mean squared error of the predictions on the '
        f"held-out episodes in units of the noise, {relative(report.gap)}. The scale is logarithmic.</p>"
    )


def relative(gap: Level) -> str:
    """What a ladder counts in."""
    return "relative to the nominal model" if gap.before >= 1 else "relative to what rounding may do"


def distance(report: GapReport) -> str:
    """How far apart recorded and simulated states lie as distributions."""
    found = report.distance
    rungs = [("nominal model", found.before), ("+ parameters", found.after_parameters)]
    rungs += [("+ effects", found.after_effects)] if report.effects else []
    rows = [[text(label), f"<b>{number(v, 3)}</b>"] for label, v in [*rungs, ("noise floor", found.noise_floor)]]
    ahead = max(report.horizons, default=0) * report.control_dt
    return (
        f"{table(['simulated with', 'distance'], rows)}<p class='small soft'>Wasserstein distance between the states "
        f"recorded and predicted {number(ahead)} s ahead, over {found.windows} held-out windows; each channel is in "
        "units of its own standard deviation.</p>"
    )


def _along(value: float, low: float, high: float) -> float:
    """Place of a value on the scale, in percent."""
    if not math.isfinite(value):
        return 100.0 if value > 0 else 0.0
    if value <= 0:
        return 0.0
    return 100 * min(max((math.log10(value) - low) / (high - low), 0.0), 1.0)


def ranking(report: GapReport) -> str:
    """Accepted causes first, then every candidate that was refitted, best first."""
    accepted = [(c.effect, c.target) for c in report.effects]
    rivals = {(r.effect, r.target) for c in report.effects for r in c.indistinguishable}
    others = [c for c in report.ranking if (c.effect, c.target) not in accepted]
    causes = [*report.effects, *others]
    if not causes:
        return "<p>No candidate was worth a refit: in the screening none removed more than noise would.</p>"
    rows = []
    for i, c in enumerate(causes):
        if i < len(accepted):
            note = '<b class="effects">accepted</b>'
        elif (c.effect, c.target) in rivals:
            note = "fits as well"
        else:
            note = "not accepted"
        rows.append([str(i + 1), _name(c, note), _shrink(c), fitted_all(c)])
    head = ["", "cause", "share of the gap it removes (95% interval)", "fitted values (95% interval)"]
    first = table(head, rows[:_FIRST], "causes")
    if len(rows) <= _FIRST:
        return first
    rest = table(head, rows[_FIRST:], "causes")
    return f"{first}<details><summary>{len(rows) - _FIRST} more candidates</summary>{rest}</details>"


def _name(c: Cause, note: str) -> str:
    reading = f" (as {text(c.reading)})" if c.reading else ""
    return (
        f"<b>{text(called(c.effect, c.target))}</b>{reading}<br><span class='small'>{note}</span><br>"
        f"<span class='small soft'>{text(c.sentence)}</span>"
    )


def _shrink(c: Cause) -> str:
    ends = [100 * min(max(v, 0.0), 1.0) if math.isfinite(v) else 0.0 for v in (c.shrink, c.shrink_low, c.shrink_high)]
    return (
        f"<b>{percent(c.shrink)}</b> ({percent(c.shrink_low)} to {percent(c.shrink_high)})"
        f'<div class="track"><i style="width:{ends[0]:.1f}%"></i>'
        f'<b style="left:{ends[1]:.1f}%;width:{max(ends[2] - ends[1], 0.6):.1f}%"></b></div>'
        f'<span class="small soft">gain {number(c.gain, 3)} ± {number(c.gain_error, 2)} nats a window</span>'
    )


def fitted_all(c: Cause) -> str:
    """Every fitted value of a cause."""
    return "<br>".join(f"{text(name)} {fitted(v)}" for name, v in c.parameters.items())


def fitted(v: Fitted) -> str:
    """A value with unit, interval, and a flag where it leans on its bound."""
    flag = ' <span class="flag">▲ at its bound</span>' if v.at_bound else ""
    value, interval = with_interval(v)
    return f"<b>{value}</b>{text(v.behind)} ({interval}){flag}"


def rivals(report: GapReport) -> str:
    """Sets of effects that these recordings cannot tell apart, and what to record."""
    cards = []
    for c in report.effects:
        if c.indistinguishable:
            others = "".join(f"<li>{text(called(r.effect, r.target))}</li>" for r in c.indistinguishable)
            what = text(c.separating_experiment) or "No experiment was found that would."
            cards.append(
                f'<div class="card"><b>{text(called(c.effect, c.target))}</b> explains these recordings as well as:'
                f"<ul>{others}</ul><b>To tell them apart:</b> {what}</div>"
            )
    if cards:
        return "".join(cards)
    if report.effects:
        return "<p>No other candidate explains the recordings as well as the accepted ones.</p>"
    return "<p>No effect was accepted, so there is nothing to tell apart.</p>"
