"""`report.html`: the diagnosis on one page that opens offline, and `summary.png` beside it."""

from __future__ import annotations

from pathlib import Path

from nfpde.gap.drawing_summary import draw_summary
from nfpde.gap.html_causes import called, distance, fitted, ladder, ranking, rivals
from nfpde.gap.html_curves import horizons, residual_force, traces
from nfpde.gap.html_robot import gap_map, where
from nfpde.gap.html_style import STYLE
from nfpde.gap.html_svg import number, percent, table, text
from nfpde.gap.report import GapReport
from nfpde.gap.written import channel_unit, joint_unit
from nfpde.storage import write_whole

_BADGE = {"effects": "✓ explained", "no_gap": "✓ no gap", "unexplained": "✗ not explained"}

# the browser itself is told to fetch nothing
_HEAD = (
    '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
    'content="width=device-width,initial-scale=1"><meta http-equiv="Content-Security-Policy" '
    "content=\"default-src 'none'; style-src 'unsafe-inline'\">"
)


def write_report(report: GapReport, folder: Path | str) -> Path:
    """Write `report.html` and `summary.png` into a folder, which is made where it is missing.

    The same report gives the same bytes.

    Args:
        report: of `diagnose_gap`.
        folder: where to.

    Returns:
        The path of the page.
    """
    path = Path(folder) / "report.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    draw_summary(report, path.with_name("summary.png"))
    write_whole(path, page(report).encode("utf-8", "replace"))
    return path


def page(report: GapReport) -> str:
    """The whole page."""
    sections = [
        (
            "How far the gap shrinks",
            f"{ladder(report)}<h2>The gap at every horizon</h2>{horizons(report)}<h2>Distance between recorded and "
            f"simulated states</h2>{distance(report)}",
        ),
        ("Where it lies", where(report)),
    ]
    columns = "".join(f"<section><h2>{title}</h2>{body}</section>" for title, body in sections)
    below = [
        ("Causes, ranked", ranking(report)),
        ("What cannot be told apart", rivals(report)),
        ("Where and when: joint by regime", gap_map(report)),
        ("The worst windows, before and after", traces(report)),
    ]
    if (force := report.residual_force) is not None:
        below.insert(0, ("The force that is left over", residual_force(force)))
    rest = "".join(f"<section><h2>{title}</h2>{body}</section>" for title, body in below)
    lines = "".join(f"<li>{text(line)}</li>" for line in report.summary)
    return (
        f"{_HEAD}<title>{text(headline(report))}</title><style>{STYLE}</style></head><body><main><header>"
        f'<span class="badge {report.verdict}">{_BADGE[report.verdict]}</span><h1>{text(headline(report))}</h1>'
        f'<ul class="summary">{lines}</ul></header><div class="cols">{columns}</div>{rest}'
        f'<div class="cols"><section><h2>Base parameters fitted</h2>{_base(report)}</section>'
        f"<section><h2>Sensor noise found</h2>{_noise(report)}</section></div>"
        f"<section><h2>Facts</h2>{_facts(report)}</section></main></body></html>\n"
    )


def headline(report: GapReport) -> str:
    """The verdict in one plain sentence."""
    causes = [called(c.effect, c.target) for c in report.effects]
    named = causes[0] if len(causes) == 1 else ", ".join(causes[:-1]) + " and " + causes[-1] if causes else ""
    if report.verdict == "effects":
        return f"The sim-to-real gap comes from {named}."
    if report.verdict == "no_gap":
        return "There is no sim-to-real gap beyond the noise: the model, with its parameters fitted, is good."
    force = report.residual_force
    # `where` is of the gap before any effect; what accepted effects leave may lie elsewhere, where the force acts
    joint = report.where[0].joint if report.where else ""
    joint = force.joint if force is not None and causes else joint
    place = f" at {joint}" if joint else ""
    found = f" besides {named}" if named else ""
    return f"A gap remains{place}{found} that no effect in the library explains."


def _base(report: GapReport) -> str:
    if not report.base:
        return "<p>No parameter was free.</p>"
    rows = [[f"{text(name)}", fitted(value)] for name, value in report.base.items()]
    return table(["parameter", "value (95% interval)"], rows)


def _noise(report: GapReport) -> str:
    if not report.sensor_noise:
        return "<p>No sensor noise was estimated.</p>"
    model, noise = report.model, report.sensor_noise.items()
    rows = [[text(name), f"{number(value, 3)} {channel_unit(model, name)}"] for name, value in noise]
    body = table(["channel", "standard deviation"], rows)
    if len(rows) > 12:
        body = f"<details><summary>{len(rows)} channels</summary>{body}</details>"
    if not report.encoder_error:
        return body
    rows = [[text(j), f"{number(error)} {joint_unit(model, j)}"] for j, error in report.encoder_error.items()]
    return body + table(["joint at rest", "reads too high by"], rows)


def _facts(report: GapReport) -> str:
    facts = {
        "gap left": f"{percent(report.gap.after_effects)} of the nominal model's; noise floor "
        f"{percent(report.gap.noise_floor)}",
        "episodes held out": ", ".join(report.held_out_episodes) or "none",
        "control step": f"{number(report.control_dt)} s",
        "candidates tried": str(report.candidates),
        "simulated steps": f"{report.simulated_steps:,}",
        "simulated on": report.device,
        "time taken": f"{report.seconds:.1f} s",
        "seed": str(report.seed),
    }
    return "<dl>" + "".join(f"<dt>{k}</dt><dd>{text(v)}</dd>" for k, v in facts.items()) + "</dl>"
