"""The page: what the recordings told, in words, tables and pictures; nothing is loaded from elsewhere."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from nfpde.errors import BadInput
from nfpde.estimation.report.numbers import number, with_std
from nfpde.estimation.report.pictures import draw_errors, draw_pairs, most_interesting
from nfpde.estimation.result import FitResult
from nfpde.storage import write_whole

SAMPLES = 3000
MOST_ROBOTS = 60
"""Robots with rows and points of their own; of more the first are shown."""

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#202124;max-width:62rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2.2rem}img{max-width:100%}
table{border-collapse:collapse;font-size:.9em}td,th{padding:.25em .7em;border-bottom:1px solid #dadce0;text-align:left}
td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}.wide{overflow-x:auto}
.bar{display:inline-block;width:7em;height:.7em;background:#e8eaed}.bar i{display:block;height:100%;background:#0072B2}
.warn{color:#b3261e}.note{color:#5f6368;font-size:.9em}
@media(prefers-color-scheme:dark){body{background:#202124;color:#e8eaed}td,th{border-color:#3c4043}img{background:#fff}
.bar{background:#3c4043}.note{color:#9aa0a6}.warn{color:#f28b82}}
"""


def write_report(result: FitResult, folder: str | Path) -> dict[Path, str]:
    """Write report.html and report.png into a folder; returns what each shows.

    Args:
        result: of `fit` with the method `trajectory`.
        folder: where to.

    Raises:
        BadInput: the result of another method.
    """
    if "tells" not in result.info:
        raise BadInput(f"a fit by the method {result.info.get('method')} has no report; trajectory has")
    folder = Path(folder)
    info, space = result.info, result.distribution.space
    left = [info["tells"]["parameters"][p.name]["left_of_prior"] for p in space]
    robots = info["robots"][:MOST_ROBOTS]
    pairs = draw_pairs(space, result.distribution.sample(SAMPLES), robots, most_interesting(left))
    write_whole(folder / "report.png", pairs)
    sections = [
        _head(info),
        _section(
            "Robots and population",
            _image(pairs, "every robot's parameters and the population"),
            _pairs_note(info, left),
        ),
        _section("What the recordings tell", _told(result), _combinations(info)),
        _section("What to record next", _next(info)),
        _section("Errors before and after", _image(draw_errors(info["residuals"]), "errors"), _errors(info)),
        _section("The population", _population(info)),
        _section("Robots", _robots(result)),
        _section("How it was made", _made(info)),
    ]
    page = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width"><title>nfpde fit</title><style>{_STYLE}</style></head>'
        f"<body>{''.join(sections)}</body></html>\n"
    )
    write_whole(folder / "report.html", page)
    return {
        folder / "report.html": "the report; it opens offline",
        folder / "report.png": "every robot's parameters and the population",
    }


def _head(info: dict[str, Any]) -> str:
    robots, told = info["robots"], info["tells"]["parameters"].values()
    known = sum(2 * row["told"] >= row["robots"] for row in told)
    ended = (
        ""
        if info["converged"]
        else '<p class="warn">The fit had not settled when its rounds were over: give it more.</p>'
    )
    # results of earlier versions have no cautions
    ended += "".join(f'<p class="warn">{escape(text)}</p>' for text in info.get("cautions", ()))
    return (
        f"<h1>{len(robots)} robot{'s' if len(robots) != 1 else ''}, {len(told)} parameters</h1><p>The recordings "
        f"({info['episodes']} episodes, {info['transitions']} windows) tell {known} of {len(told)} parameters for most "
        f"robots. The fit took {info['simulated_steps'] / 1e6:.2g} million simulated steps and {info['seconds']:.0f} s."
        f"</p>{ended}"
    )


def _pairs_note(info: dict[str, Any], left: Sequence[float]) -> str:
    parts = []
    if len(left) > len(most_interesting(left)):
        parts.append(f"Shown are the {len(most_interesting(left))} of {len(left)} parameters that are known least.")
    if len(info["robots"]) > MOST_ROBOTS:
        parts.append(f"Shown are the first {MOST_ROBOTS} of {len(info['robots'])} robots.")
    parts.append("The axes span the bounds.")
    return f'<p class="note">{" ".join(parts)}</p>'


def _told(result: FitResult) -> str:
    info, space = result.info, result.distribution.space
    xi = result.distribution.sample(SAMPLES)
    rows = []
    for i, p in enumerate(space):
        row = info["tells"]["parameters"][p.name]
        leaning = [r["parameters"][p.name]["leans_on"] for r in info["robots"]]
        hits = [f"{leaning.count(side)} on the {side} one" for side in ("low", "high") if side in leaning]
        rows.append(
            [
                escape(p.name),
                escape(row["words"]),
                f'<span class="bar"><i style="width:{100 * (1 - row["left_of_prior"]):.0f}%"></i></span>',
                with_std(float(xi[:, i].mean()), float(xi[:, i].std())) + escape(f" {p.unit}" if p.unit != "-" else ""),
                f"{p.low:.4g} to {p.high:.4g}",
                f'<span class="warn">{" and ".join(hits)}</span>' if hits else "none",
            ]
        )
    heads = ["parameter", "each robot", "told", "population, mean ± std", "bounds", "robots that lean on a bound"]
    return _table(heads, rows)


def _combinations(info: dict[str, Any]) -> str:
    tells, total = info["tells"], len(info["robots"])
    lines = [f"{escape(row['words'])} ({row['robots']} of {total} robots)" for row in tells["combinations"][:12]]
    if not lines:
        return "<p>No two parameters stand in for each other.</p>"
    return "<p>Known only together:</p>" + _list(lines)


def _next(info: dict[str, Any]) -> str:
    if not info["record_next"]:
        return "<p>Nothing: every parameter is known to a twentieth of its bounds' width for most robots.</p>"
    note = (
        '<p class="note">Found by simulating the recorded moments again, with one joint faster or one command at its '
        "recorded extreme, and comparing what they would tell.</p>"
    )
    return _list([escape(row["words"]) for row in info["record_next"]]) + note


def _errors(info: dict[str, Any]) -> str:
    columns = ("before", "after", "sensor", "simulation")
    rows = [[escape(name), *(number(row[c]) for c in columns)] for name, row in info["residuals"].items()]
    note = (
        '<p class="note">Root mean square, in the recorded units, one window ahead. Before: every parameter in the '
        "middle of its bounds. What is left is put down to errors of the measured states, which a window's start hands "
        "on to its end, and to what the simulation lacks; both columns are standard deviations, tails included. Tails: "
        f"Student's t with {info['noise_degrees']:g} degrees of freedom.</p>"
    )
    return f"<details><summary>Numbers</summary>{_table(['channel', *columns], rows)}</details>{note}"


def _population(info: dict[str, Any]) -> str:
    found = info["population"]
    if not found["candidates"]:
        return "<p>One robot tells nothing of others: the population is its own posterior.</p>"
    used = "informs every robot's posterior" if found["informs_robots"] else "is not used for the robots' posteriors"
    ordered = sorted(found["candidates"], key=lambda row: -row["held_out"])
    rows = [
        [
            ("<b>" + escape(row["name"]) + "</b>") if row["name"] == found["chosen"] else escape(row["name"]),
            f"{row['held_out']:.2f}",
        ]
        for row in ordered
    ]
    return (
        f"<p>Robots left out are predicted with {found['held_out']:.2f} ± {found['held_out_error']:.2f} nats a robot "
        f"more than by the bounds alone, so the population of the others {used}.</p>"
        + _table(["population", "held-out log likelihood above the bounds' [nats a robot]"], rows)
        + '<p class="note">Bold: the one that was taken. Smoothed posteriors give way only to what gains more than the '
        "gain's standard error over the robots.</p>"
    )


def _robots(result: FitResult) -> str:
    info, space, rows = result.info, result.distribution.space, []
    for robot in info["robots"][:MOST_ROBOTS]:
        sampling = robot["sampling"]
        how = f"{sampling['effective']:.0f} of {sampling['draws']}" + (
            "" if sampling["simulated"] else ", Laplace's instead"
        )
        cells = []
        for name in space.names:
            p = robot["parameters"][name]
            shown = with_std(p["value"], p["std"])
            cells.append(f'<span class="warn">{shown}</span>' if p["leans_on"] else shown)
        rows.append([escape(robot["robot"]), str(robot["windows"]), str(robot["modes"]), how, *cells])
    named = [escape(f"{p.name} [{p.unit}]" if p.unit else p.name) for p in space]
    heads = ["robot", "windows", "modes", "effective draws", *named]
    return f'<div class="wide">{_table(heads, rows)}</div><p class="note">Red: leans on a bound.</p>'


def _made(info: dict[str, Any]) -> str:
    kept = {
        k: info[k] for k in ("method", "config", "seed", "resolution", "simulator", "dataset", "versions") if k in info
    }
    return f"<pre>{escape(json.dumps(kept, indent=1, ensure_ascii=False))}</pre>"


def _section(title: str, *parts: str) -> str:
    return f"<h2>{title}</h2>{''.join(parts)}"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def cell(text: str) -> str:
        return (
            f'<td class="n">{text}</td>'
            if text[:1].isdigit() or text[:2].strip("-")[:1].isdigit()
            else f"<td>{text}</td>"
        )

    head = "".join(f"<th>{h}</th>" for h in heads)
    body = "".join(f"<tr>{''.join(map(cell, row))}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _list(lines: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{line}</li>' for line in lines)}</ul>"


def _image(png: bytes, text: str) -> str:
    return f'<img alt="{escape(text)}" src="data:image/png;base64,{b64encode(png).decode()}">'
