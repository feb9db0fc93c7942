"""The table of all finished cells, with what failed and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from nfpde.bench.estimation.verdicts import (
    OVER_BOUND,
    PAPER_SECONDS,
    RATIO,
    UNKNOWN,
    Verdict,
    closeness,
    errors,
    fresh,
    judge,
    seconds,
)

HEAD = (
    "| robot | target | noise | seed | before | softmax (oracle) | trajectory | ratio | error / bound (whole) | "
    "error / std | fresh: softmax | trajectory | truth | Msteps: softmax | trajectory | CPU s: softmax | trajectory | "
    "two cores, s (paper) | verdict |"
)


def order(cell: dict[str, Any]) -> tuple[Any, ...]:
    """Sorts cells as the table shows them."""
    key = cell["cell"]
    robots = [*RATIO]
    place = robots.index(key["robot"]) if key["robot"] in robots else len(robots)
    return place, key["robot"], key["target"], key["noise"], key["seed"]


def line(cell: dict[str, Any]) -> str:
    """The cell's row."""
    key, near, far, found = cell["cell"], closeness(cell), fresh(cell), errors(cell)
    first, own = cell["softmax"]["fits"][0], cell["trajectory"]
    over = "" if found["over_bound"] is None else f"{found['over_bound']:.2f} ({found['over_whole']:.2f})"
    paper = PAPER_SECONDS.get(key["robot"])
    failed = [v.name for v in judge(cell) if not v.passed]
    return "| " + " | ".join(
        [
            *(key["robot"], key["target"], f"{key['noise']:.1%}" if key["noise"] else "0", f"{key['seed']}"),
            f"{cell['before']['uniform']['to_episodes']['physical']:.3g}",
            f"{near['softmax']:.3g} ({near['oracle']:.3g})",
            f"{near['trajectory']:.3g}",
            f"{near['ratio']:.2g}",
            over,
            f"{found['over_std']:.2f}" if key["noise"] else "",
            *(f"{far[k]:.3g}" for k in ("softmax", "trajectory", "population")),
            f"{first['million_steps']:.3g}",
            f"{own['million_steps']:.3g}",
            f"{first['cpu_seconds']:.0f}",
            f"{own['cpu_seconds']:.0f}",
            f"{seconds(cell, own):.1f}" + (f" ({paper:g})" if paper else ""),
            "pass" if not failed else "FAIL: " + ", ".join(failed),
        ]
    ) + " |"  # fmt: skip


def row(cell: dict[str, Any]) -> dict[str, Any]:
    """The cell's figures and verdicts as plain JSON values."""
    own = cell["trajectory"]
    return {
        **cell["cell"],
        "code": cell["code"],
        "before": cell["before"]["uniform"]["to_episodes"],
        "to_episodes": closeness(cell),
        "to_population": fresh(cell),
        "errors": errors(cell),
        "million_steps": {"softmax": cell["softmax"]["fits"][0]["million_steps"], "trajectory": own["million_steps"]},
        "cpu_seconds": {"softmax": cell["softmax"]["fits"][0]["cpu_seconds"], "trajectory": own["cpu_seconds"]},
        "two_core_seconds": seconds(cell, own),
        "verdicts": [vars(v) for v in judge(cell)],
    }


def table(cells: list[dict[str, Any]], command: str) -> str:
    """The whole page, Markdown."""
    cells = sorted(cells, key=order)
    verdicts = [(c, v) for c in cells for v in judge(c)]
    return "\n".join(
        [
            "# Estimation: whole trajectories beside softmax",
            "",
            *_explanation(),
            "",
            HEAD,
            "|" + "---|" * (HEAD.count(" | ") + 1),
            *map(line, cells),
            "",
            *_summary(verdicts),
            "",
            *_failures(verdicts),
            *_friction(cells),
            *_temperatures(cells),
            *_origin(cells, command),
            "",
        ]
    )


def _explanation() -> list[str]:
    limits = ", ".join(f"{robot} {limit:g}" for robot, limit in RATIO.items())
    return [
        "Ten episodes of uniform random commands, one robot each, at most 150 control steps, ended by a fall. `noise`: "
        "white Gaussian noise on every measured state, in standard deviations of each channel over the recordings; "
        "both methods see the same data. Distances are exact optimal transport (Euclidean, physical units as in the "
        "paper) from samples of the estimate to the ten robots' true parameters; `before`: uniform draws of the box.",
        "",
        "`softmax`: the best of a fit that finds its own beta and of fits with fixed betas around that one, as its "
        "user would choose: by the marginal likelihood of the recordings (Eq. 5). `oracle`: the one closest to the "
        "truth, which no user can know. The budget of each is that of `nfpde bench fit`; steps and seconds are of one "
        "fit, not of the search. `trajectory`: the equal mixture of the robots' posteriors; its smoothed population is "
        "what `fresh` measures, the distance to fresh draws of the true population, beside what fresh draws of the "
        "truth themselves get.",
        "",
        "`error / bound`: root-mean-square error of the robots' best values in Cramer-Rao bounds (at the true "
        "parameters and with the true noise, prior included), every transition taken as measured anew. `whole`: in the "
        "bound of all estimates there can be; it is sharper, because a measured state ends one transition and starts "
        "the next, so that neighbours share its error. `error / std`: in the fit's own standard deviations. "
        "`two cores`: simulated steps over the steps that two cores make in a second when nothing else runs (the most "
        "that any cell of the robot has measured); in brackets the paper's time on a graphics card (Table III). CPU s: "
        "of both cores together, everything included.",
        "",
        f"Wanted: without noise `ratio` at most {limits}, and fewer steps than softmax; with noise `error / bound` at "
        f"most {OVER_BOUND:g}, for single transitions (`bound`) and for whole episodes (`whole`), and never farther "
        "than softmax; never farther from fresh draws than softmax; less time than the paper's.",
    ]


def _summary(verdicts: list[tuple[dict[str, Any], Verdict]]) -> list[str]:
    names = dict.fromkeys(v.name for _, v in verdicts)
    counts = []
    for name in names:
        passed = [v.passed for _, v in verdicts if v.name == name]
        counts.append(f"{name} {sum(passed)} of {len(passed)}")
    return ["Met: " + "; ".join(counts) + "."]


def _failures(verdicts: list[tuple[dict[str, Any], Verdict]]) -> list[str]:
    rows = [f"- {_title(c)}, **{v.name}**: {v.text}." for c, v in verdicts if not v.passed]
    return ["## What fails, and why", "", *rows, ""] if rows else []


def _friction(cells: list[dict[str, Any]]) -> list[str]:
    """What every episode tells of the floor's friction: nothing where no foot slides."""
    rows, controls, blind, episodes = [], [], 0, 0
    for cell in cells:
        at = [i for i, name in enumerate(cell["parameters"]) if name.startswith("geom_friction")]
        if not at:
            continue
        i, robots, title = at[0], cell["trajectory"]["robots"], _title(cell)
        known = [k[i] for k in robots["known"]]
        blind, episodes = blind + sum(k < UNKNOWN for k in known), episodes + len(known)
        bounds = [_in_widths(b[i], cell["width"][i]) for b in robots["cramer_rao"]]
        off = [abs(v[i] - t[i]) / cell["width"][i] for v, t in zip(robots["value"], robots["true"], strict=True)]
        felt = _shares(f[i] for f in cell["bound"]["felt"])
        rows.append(f"| {title} | {felt} | {' '.join(bounds)} | {_shares(known)} | {_numbers(off)} |")
        stuck = cell.get("without sliding")
        if stuck:
            bounds = [_in_widths(b, cell["width"][i]) for b in stuck["cramer_rao"]]
            transitions = " ".join(f"{n}" for n in stuck["transitions"])
            shares = f"{_shares(stuck['known'])} | {_shares(stuck['others_known'])}"
            controls.append(f"| {title} | {transitions} | {' '.join(bounds)} | {shares} |")
    if not rows:
        return []
    control = [
        "Control: the same recordings without the transitions in which anything slides, fitted alone.",
        "",
        "| cell | transitions left | bound | known of friction | median known of the other parameters |",
        "|---|---|---|---|---|",
        *controls,
        "",
    ]
    return [
        "## Floor friction, episode by episode",
        "",
        "A transition in which nothing slides says nothing about friction. `slides`: share of an episode's "
        "transitions whose next state friction moves at all, at the true parameters. From fit.json: `bound`, its "
        "Cramer-Rao bound in widths of the box (none: not determined; the prior's standard deviation is 0.29), and "
        "`known`, the share of the prior's width that the recording took away. `off`: error, in widths. "
        f"{blind} of {episodes} episodes leave it unknown (known below {UNKNOWN:.0%}).",
        "",
        "| cell | slides | bound | known | off |",
        "|---|---|---|---|---|",
        *rows,
        "",
        *(control if controls else []),
    ]


def _in_widths(bound: float | None, width: float) -> str:
    return "none" if bound is None else f"{bound / width:.2g}"


def _shares(values: Iterable[float]) -> str:
    return " ".join(f"{v:.0%}" for v in values)


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{v:.2g}" for v in values)


def _temperatures(cells: list[dict[str, Any]]) -> list[str]:
    rows = []
    for cell in cells:
        softmax = cell["softmax"]
        for k, f in enumerate(softmax["fits"]):
            marks = [m for m in ("chosen", "oracle") if softmax[m] == k]
            rows.append(
                f"| {_title(cell)} | {'own, at last ' if f['automatic'] else ''}{f['beta']:.2g} | "
                f"{f['effective']:.3g} | {f['score']:.1f} | {f['to_episodes']['physical']:.3g} | "
                f"{f['to_population']['physical']:.3g} | {', '.join(marks)} |"
            )
    return [
        "## Softmax at several temperatures",
        "",
        "| cell | beta | effective samples | log likelihood a transition | OT | OT to fresh draws | |",
        "|---|---|---|---|---|---|---|",
        *rows,
        "",
    ]


def _origin(cells: list[dict[str, Any]], command: str) -> list[str]:
    texts = []
    for method in ("trajectory", "softmax"):
        counts = Counter(cell["code"][method] for cell in cells)
        texts.append(f"{method} " + ", ".join(f"{code} ({n} cells)" for code, n in counts.items()))
    last = cells[-1]
    load = np.median([c["trajectory"]["seconds"] / max(c["trajectory"]["cpu_seconds"], 1e-9) for c in cells])
    devices = ", ".join(dict.fromkeys(c["device"] for c in cells))
    return [
        f"`{command}`; code of {'; of '.join(texts)}; settings {last['settings']}; versions {last['versions']}; "
        f"{last['machine']}; fits simulated on {devices}. Median wall seconds a CPU second: {load:.2f} (0.5 "
        "where two cores are free). Every cell is a file in a folder beside this one."
    ]


def _title(cell: dict[str, Any]) -> str:
    key = cell["cell"]
    noise = f"{key['noise']:.1%}" if key["noise"] else "no"
    return f"{key['robot']}, {key['target']}, {noise} noise, seed {key['seed']}"
