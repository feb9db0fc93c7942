"""Coverage of the posteriors of random robots, as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from nfpde.bench.estimation.ranks import WANTED, coverage, histogram
from nfpde.bench.estimation.stages import SCHEMA_VERSION, code_of, results
from nfpde.benchmarks import robot
from nfpde.storage import read_json

Array = NDArray[np.float64]

TITLES = {"anew": "measured anew", "differenced": "velocities differenced", "filtered": "velocities filtered"}
"""Of recordings that are made in other ways than with noise on every state."""

CHANCE = 3.0
"""A parameter whose coverage is more standard errors off than this is not off by chance."""


def summary(content: dict[str, Any]) -> dict[str, Any]:
    """Problems, coverage and histograms of a finished or unfinished file."""
    facts, problems = content["facts"], list(results(content).values())
    ranks, samples = [r["rank"] for r in problems], facts["settings"]["samples"]
    return {
        "facts": facts,
        "parameters": robot(facts["robot"]).space.names,
        "problems": problems,
        "coverage": {share: coverage(ranks, samples, int(share) / 100) for share in WANTED},
        "histogram": histogram(ranks, samples),
        "code": ", ".join(dict.fromkeys(code_of(stage) for stage in content["stages"].values())),
    }


def table(folder: Path, command: str) -> str:
    """Everything in the folder, finished or not, Markdown."""
    lines, off, judged = [], [], 0
    for path in sorted(folder.glob("*.json")):
        if path.with_suffix(".part.json").is_file():
            # more problems are being added; the unfinished file holds the finished ones too
            continue
        content = summary(read_json(path, SCHEMA_VERSION))
        lines += _section(content, f"{folder.name}/{path.name.partition('.')[0]}.png")
        off += _off(content)
        judged += len(content["parameters"]) * len(content["coverage"])
    if off:
        chance = judged * 2 * float(norm.sf(CHANCE))
        lines += [
            "## Parameters that fail",
            "",
            f"Of {judged} coverages of single parameters, {chance:.2g} would be more than {CHANCE:g} standard errors "
            "off if all posteriors were right.",
            "",
            *(f"- {text}" for text in off),
            "",
        ]
    return "\n".join(
        [
            "# Calibration by simulation",
            "",
            "Every problem is a robot drawn uniformly from the box, which is the estimator's prior, recorded under "
            "random commands with white noise on every measured state (0.1 % to 1 % of each channel's standard "
            "deviation, drawn log-uniformly) and fitted alone by `trajectory`. A central region of its posterior must "
            "hold the true value as often as it says: all parameters together 45 % to 55 % and 85 % to 95 %, each one "
            f"to within {CHANCE:g} standard errors. After ±: one standard error, binomial for a parameter; for all "
            "together from the spread over problems, because the parameters of one problem are not independent. "
            "`error / std`: root mean square of the error of the posterior mean in posterior standard deviations; 1 "
            "is calibrated, less is too wide.",
            "",
            "`measured anew` is a control: each transition is a recording of its own, whose two states have errors of "
            "their own. In a recording as it comes a measured state ends one transition and starts the next. Of "
            "`payload`, a hand and what it holds, recordings tell the sum of the masses, the bounds all that is known "
            "of either. `velocities differenced`: positions alone were measured, velocities are their central "
            "differences, as the data say. `velocities filtered`: differences to the row before through a low-pass of "
            "a control step's time constant, which the data do not say.",
            "",
            *lines,
            f"`{command}`.",
            "",
        ]
    )


def _off(content: dict[str, Any]) -> list[str]:
    """Of every parameter whose coverage is off: whether its posteriors lie beside the truth or are of a wrong width."""
    found, errors = [], _errors(content)
    for i, name in enumerate(content["parameters"]):
        own, n = errors[:, i], len(errors)
        found += [
            f"{_title(content)}, {name}, {share} %: {row['by_parameter'][i]:.0%}; errors are {own.mean():.2f} "
            f"± {1 / np.sqrt(n):.2f} posterior standard deviations on average, {np.sqrt((own**2).mean()):.2f} "
            f"± {1 / np.sqrt(2 * n):.2f} as a root mean square, {np.abs(own).max():.1f} at most."
            for share, row in content["coverage"].items()
            if not _passes(row["by_parameter"][i], row["error"], share)
        ]
    return found


def _errors(content: dict[str, Any]) -> Array:
    """Of the posteriors' means, in their standard deviations, (problems, D)."""
    return np.array(
        [[(m - t) / s for m, t, s in zip(r["mean"], r["true"], r["std"], strict=True)] for r in content["problems"]]
    )


def _title(content: dict[str, Any]) -> str:
    sensing = content["facts"]["sensing"]
    return content["facts"]["robot"] + (f", {TITLES[sensing]}" if sensing else "")


def _section(content: dict[str, Any], picture: str) -> list[str]:
    half, most = (content["coverage"][share] for share in WANTED)
    done, facts = content["problems"], content["facts"]
    off = _errors(content)
    rows = []
    for i, name in enumerate(content["parameters"]):
        cells = [
            _judged(found["by_parameter"][i], found["error"], share) for share, found in content["coverage"].items()
        ]
        rows.append(f"| {name} | {cells[0]} | {cells[1]} | {np.sqrt((off[:, i] ** 2).mean()):.2f} |")
    verdicts = []
    for share, found in zip(WANTED, (half, most), strict=True):
        low, high = WANTED[share]
        error = "" if found["pooled_error"] is None else f" ± {found['pooled_error']:.1%}"
        passed = "pass" if low <= found["pooled"] <= high else f"FAIL: {low:.0%} to {high:.0%} wanted"
        verdicts.append(f"{found['pooled']:.1%}{error} {passed}")
    return [
        f"## {_title(content)}",
        "",
        "| parameter | central 50 % holds | central 90 % holds | error / std |",
        "|---|---|---|---|",
        *rows,
        f"| all | {verdicts[0]} | {verdicts[1]} | {np.sqrt((off**2).mean()):.2f} |",
        "",
        f"![rank histograms]({picture})",
        "",
        f"{len(done)} of {facts['problems']} problems, {facts['episodes']} episode(s) each, median "
        f"{np.median([r['transitions'] for r in done]):.0f} transitions and "
        f"{np.median([r['million_steps'] for r in done]):.2g} million simulated steps; code {content['code']}.",
        "",
    ]


def _passes(covered: float, error: float, share: str) -> bool:
    return abs(covered - int(share) / 100) <= CHANCE * error


def _judged(covered: float, error: float, share: str) -> str:
    return f"{covered:.0%} ± {error:.0%}" + ("" if _passes(covered, error, share) else " FAIL")
