"""The robot with its joints coloured by their share of the gap, and the gap map beside it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nfpde.gap.drawing import project
from nfpde.gap.drawing_layout import Disc, Layout, lay_out
from nfpde.gap.html_svg import percent, shade, text
from nfpde.gap.report import GapMap, GapReport
from nfpde.gap.words import WHEN


def shares(report: GapReport) -> dict[str, float]:
    """The joints' shares of the gap; none where there is no gap to place."""
    if report.verdict == "no_gap" or not any(p.share > 0 for p in report.where):
        return {}
    return {p.joint: p.share for p in report.where}


def where(report: GapReport) -> str:
    """The section: the picture, its colour scale, and every joint with its worst regime."""
    share = shares(report)
    layout = lay_out(project(report.model), share)
    if not share:
        return f"{robot(layout, share)}<p>There is no gap to place: the joints are not coloured.</p>"
    ends = ", ".join(shade(t)[0] for t in np.linspace(0, 1, 6))
    top = max(d.share for d in layout.discs) if layout.discs else 0.0
    rows = "".join(
        f"<li>{text(p.joint)}: <b>{percent(p.share)}</b>, most of all {text(WHEN.get(p.regime, p.regime))}</li>"
        for p in report.where[:3]
        if p.share > 0
    )
    return (
        f"{robot(layout, share)}<p class='small soft'>Share of the gap: 0%"
        f"<span class='scale' style='background:linear-gradient(90deg,{ends})'></span>{percent(top)}; noise is "
        f"subtracted. Joints at one place share a disc.</p><ul>{rows}</ul>"
    )


def robot(layout: Layout, share: Mapping[str, float]) -> str:
    """The picture as SVG."""
    top = max([d.share for d in layout.discs] or [0.0]) or 1.0
    marks = []
    if layout.ground is not None:
        marks.append(f'<path class="ground" d="M150 {layout.ground:.1f}H{layout.width - 150:.1f}"/>')
    for outline, fixed in zip(layout.outlines, layout.fixed, strict=True):
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in outline)
        marks.append(f'<polygon class="solid{" fixed" if fixed else ""}" points="{points}"/>')
    # large discs first, so that a small one beside a large one stays visible
    for disc in sorted(layout.discs, key=lambda d: (-d.radius, d.x, d.y)):
        marks.append(_disc(disc, share, disc.share / top))
    marks += [_labels(d, share) for d in layout.discs]
    return (
        f'<div class="scroll"><svg class="robot" viewBox="0 0 {layout.width:.0f} {layout.height:.0f}" role="img" '
        f'aria-label="the robot, its joints coloured by their share of the gap">{"".join(marks)}</svg></div>'
    )


def _disc(disc: Disc, share: Mapping[str, float], part: float) -> str:
    note = ", ".join(f"{n} {percent(share[n])}" if n in share else n for n in disc.joints)
    fill = f'style="fill:{shade(part)[0]}"' if share else ""
    bare = "" if share else " bare"
    return (
        f'<circle class="disc{bare}" {fill} cx="{disc.x:.1f}" cy="{disc.y:.1f}" r="{disc.radius:.1f}">'
        f"<title>{text(note)}</title></circle>"
    )


def _labels(disc: Disc, share: Mapping[str, float]) -> str:
    if not disc.labels:
        return ""
    out = []
    side = disc.labels[0]
    at = 0.5 * (side.y + disc.labels[-1].y) - 4
    away = 4 if side.left else -4
    toward = np.array([side.x + away - disc.x, at - disc.y])
    start = np.array([disc.x, disc.y]) + toward * disc.radius / max(float(np.hypot(*toward)), 1.0)
    out.append(f'<path class="lead" d="M{start[0]:.1f} {start[1]:.1f}L{side.x + away:.1f} {at:.1f}"/>')
    for label in disc.labels:
        weight = "" if not share else (" much" if label.share >= 0.1 else " little" if label.share < 0.01 else "")
        kind = ("end" if label.left else "start") + weight
        out.append(
            f'<text x="{label.x:.1f}" y="{label.y:.1f}" class="{kind}"><title>{text(label.full)}</title>'
            f"{text(label.text)}</text>"
        )
    return "".join(out)


_ASKED = {
    "motion": "how the joint moves",
    "command": "its drive",
    "contact": "what it carries",
    "time": "half of the recording",
}
"""What each group of regimes asks."""


def gap_map(report: GapReport) -> str:
    """Joints by regimes, as a table whose cells are coloured by their share."""
    found: GapMap = report.gap_map
    share = np.nan_to_num(np.asarray(found.share, dtype=float))
    if report.verdict == "no_gap" or not share.size or share.max() <= 0:
        return "<p>What is left is noise: its places mean nothing, and no map is drawn.</p>"
    top = float(share.max())
    whole = np.nan_to_num(found.part(next(iter(found.groups)))).sum(1)
    order = np.argsort(-whole, kind="stable").tolist()
    groups = "".join(
        f'<th scope="colgroup" colspan="{n}" class="first">{text(_ASKED.get(g, g))}</th>'
        for g, n in found.groups.items()
    )
    starts = np.cumsum([0, *found.groups.values()]).tolist()
    edges = ["first" if r in starts else "" for r in range(len(found.regimes))]
    head = "".join(
        f'<th scope="col" class="{edge}">{text(r)}</th>' for r, edge in zip(found.regimes, edges, strict=True)
    )
    body = "".join(
        f'<tr><th scope="row">{text(found.joints[j])}</th><td><b>{percent(float(whole[j]))}</b></td>'
        + "".join(
            _cell(float(v), top, int(n), edge) for v, n, edge in zip(share[j], found.windows[j], edges, strict=True)
        )
        + "</tr>"
        for j in order
    )
    total = "".join(f'<td class="{edge}">{percent(float(v))}</td>' for v, edge in zip(share.sum(0), edges, strict=True))
    return (
        '<p class="small soft">Each group of columns splits the whole gap by one question, so its columns add up to '
        '"all". Before any effect, noise subtracted; the number of windows shows under the pointer.</p>'
        f'<div class="scroll"><table class="map"><thead><tr><th rowspan="2" scope="col">joint</th><th rowspan="2" '
        f'scope="col">all</th>{groups}</tr><tr>{head}</tr></thead><tbody>{body}<tr><th scope="row">all joints</th>'
        f"<td><b>{percent(float(whole.sum()))}</b></td>{total}</tr></tbody></table></div>"
    )


def _cell(value: float, top: float, windows: int, edge: str) -> str:
    note = f'title="{windows} windows"'
    if value < 0.0005:
        return f'<td class="soft {edge}" {note}>{"0" if windows else "–"}</td>'
    fill, ink = shade(value / top)
    return f'<td class="{edge}" style="background:{fill};color:{ink}" {note}>{percent(value)}</td>'
