"""The table of real robots as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

INTRODUCTION = (
    "Recordings that others published of their robots, and rigid models with the published masses and lengths: nothing "
    "may vary, and what the models leave out is for the diagnosis to find. Gaps are mean squares on episodes that no "
    "fit saw, as shares of the nominal model's; `noise` is what the sensors' noise alone would leave. Distances are "
    "those of optimal transport between recorded and simulated states at the ends of the longest windows, in standard "
    "deviations of the recorded states. `known` is what was published or measured elsewhere, not the truth: it comes "
    "from fits of the robots' makers, some of which disagree. These recordings were at hand while the diagnosis was "
    "written; no threshold was set by them."
)

_HEAD = "| robot | recorded | verdict | found, with 95 % intervals | known | gap, noise | distance | million steps |"


def line(row: Mapping[str, Any]) -> str:
    """One row."""
    recorded = f"{row['episodes']} x {row['rows'] * row['control_dt'] / row['episodes']:.0f} s"
    if "refused" in row:
        return f"| {row['name']} | {recorded} | refused | {row['refused']} | {row['known']} | | | |"
    gap, distance = row["gap"], row["distance"]
    found = "; ".join(_cause(cause) for cause in row["effects"]) or "nothing"
    return (
        f"| {row['name']} | {recorded} | {row['verdict']} | {found} | {row['known']} | "
        f"1 to {gap['after_effects']:.2g}, {gap['noise_floor']:.2g} | "
        f"{distance['before']:.2g} to {distance['after_effects']:.2g} | {row['million_steps']:.1f} |"
    )


def table(rows: Sequence[Mapping[str, Any]], facts: Mapping[str, Any]) -> str:
    """The Markdown page."""
    verdicts = [row.get("verdict", "refused") for row in rows]
    counts = ", ".join(f"{verdicts.count(v)} {v.replace('_', ' ')}" for v in dict.fromkeys(verdicts))
    windows = "" if facts["windows"] is None else f" --windows {facts['windows']}"
    return "\n".join(
        [
            "# Diagnosis of real robots",
            "",
            INTRODUCTION,
            "",
            _HEAD,
            "|" + "---|" * _HEAD.count(" | ") + "---|",
            *map(line, rows),
            "",
            f"Verdicts: {counts}. The command took {sum(row.get('seconds', 0.0) for row in rows) / 60:.0f} minutes.",
            "",
            f"`nfpde bench real RECORDINGS --seed {facts['seed']}{windows}`; versions {facts['versions']}; "
            f"{facts['machine']}, simulated on {facts['device']}.",
            "",
        ]
    )


def _cause(cause: Mapping[str, Any]) -> str:
    values = ", ".join(
        f"{name} {v['value']:.3g} ({v['low']:.3g} to {v['high']:.3g}) {v['unit']}".rstrip(" -")
        for name, v in cause["values"].items()
    )
    rivals = f" or {', '.join(cause['rivals'])}" if cause["rivals"] else ""
    return f"{cause['reading'] or cause['effect']} {cause['target']}".strip() + rivals + f": {values}"
