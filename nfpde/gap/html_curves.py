"""Curves: the worst windows before and after, the gap at every horizon, and the force left over."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nfpde.gap.html_causes import relative, scale
from nfpde.gap.html_svg import Panel, number, percent, span, text
from nfpde.gap.report import GapReport, ResidualForce, Trace


def key(entries: Sequence[tuple[str, str]]) -> str:
    """What the lines mean: CSS class and text of each."""
    return (
        '<div class="key">'
        + "".join(
            f'<span><svg viewBox="0 0 34 12"><path class="line {kind}" d="M1 6H33"/></svg>{text(what)}</span>'
            for kind, what in entries
        )
        + "</div>"
    )


def traces(report: GapReport) -> str:
    """Measured and predicted, window by window."""
    if not report.traces:
        return "<p>No window was recorded in detail.</p>"
    entries = [("measured", "measured"), ("before", "predicted with the fitted parameters")]
    if report.effects:
        entries.append(("after", "predicted with parameters and effects"))
    return f'{key(entries)}<div class="panels">{"".join(_trace(t, bool(report.effects)) for t in report.traces)}</div>'


def _trace(t: Trace, repaired: bool) -> str:
    curves = [t.measured, t.before, *([t.after] if repaired else [])]
    # a prediction that blows up must not flatten what was measured
    low, high = span(t.measured, pad=4.0)
    across, upward = span(t.time, pad=0.0), span(*[np.clip(c, low, high) for c in curves])
    panel = Panel(across, upward, f"{t.channel}, episode {t.episode}", "time in the episode [s]", t.unit)
    for curve, kind in zip(curves, ("measured", "before", "after"), strict=False):
        panel.line(t.time, curve, kind)
    return panel.svg()


def horizons(report: GapReport) -> str:
    """The ladder at every horizon, on a logarithmic scale."""
    if not report.horizons:
        return "<p>No horizon was compared.</p>"
    steps = sorted(report.horizons)
    levels = [report.horizons[h] for h in steps]
    time = np.array(steps) * report.control_dt
    stages: list[tuple[str, str, NDArray[np.float64]]] = [
        ("nominal", "nominal model", np.array([v.before for v in levels])),
        ("before", "parameters fitted", np.array([v.after_parameters for v in levels])),
        ("after", "parameters and effects", np.array([v.after_effects for v in levels])),
        ("floor", "noise floor", np.array([v.noise_floor for v in levels])),
    ]
    if not report.effects:
        del stages[2]
    bottom, top = scale(np.concatenate([s[2] for s in stages]).tolist())
    panel = Panel(
        span(time),
        (10.0**bottom, 1.2 * 10.0**top),
        "Gap by how far ahead is predicted",
        "horizon [s]",
        relative(report.gap),
        log=True,
        y_text=percent,
    )
    for kind, what, values in stages:
        panel.line(time, np.where(values > 0, values, np.nan), kind)
        for h, t, v in zip(steps, time.tolist(), values.tolist(), strict=True):
            if np.isfinite(v) and v > 0:
                panel.dot(t, v, kind, 3.2, f"{what}, {h} steps ({number(t)} s): {percent(v)}")
    return f'{key([(kind, what) for kind, what, _ in stages])}<div class="panels one">{panel.svg()}</div>'


def residual_force(force: ResidualForce) -> str:
    """The force left over against position, speed and command, with error bars of one standard error.

    Args:
        force: what was found.
    """
    unit = "m" if force.unit == "N" else "rad"
    axes = ((f"position [{unit}]", force.position), (f"speed [{unit}/s]", force.speed), ("command", force.command))
    panels = []
    keep = np.isfinite(force.force) & np.isfinite(force.error)
    y, error = force.force[keep], force.error[keep]
    # a window that tells next to nothing of the force must not flatten what the others tell
    low, high = span(y, pad=1.0)
    upward = span(np.maximum(y - error, low), np.minimum(y + error, high)) if len(y) else (-1.0, 1.0)
    for name, values in axes:
        x = values[keep]
        panel = Panel(span(x), upward, f"against {name.split()[0]}", name, f"force [{force.unit}]")
        panel.line(np.array(panel.x), np.zeros(2), "nominal")
        for a, f, e in zip(x.tolist(), y.tolist(), error.tolist(), strict=True):
            if np.isfinite(a):
                panel.bar(a, max(f - e, upward[0]), min(f + e, upward[1]), "after")
                panel.dot(a, f, "after", 2.2)
        panels.append(panel.svg())
    what = f"A smooth force of these three and time would remove <b>{percent(force.share)}</b> of what is left."
    if not force.share >= 0.01:
        what = "A smooth force of these three and time removes next to nothing of it: its cause lies elsewhere."
    return (
        f"<p>The force on <b>{text(force.joint)}</b> that the model still lacks, one point for each held-out window "
        f"that shows it, with its standard error. {what}</p>"
        f'<div class="panels">{"".join(panels)}</div>'
    )
