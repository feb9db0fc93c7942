"""The table of the benchmark as Markdown, its losing cells too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nfpde.bench.gap.score import Row
from nfpde.bench.gap.summary import (
    at_floor,
    by_effect,
    by_robot,
    by_size,
    confusion,
    coverage,
    faulty,
    figures,
    of_kind,
    rate,
    wilson,
)

ROBOTS = (
    "Robots with a hidden fault, recorded with noisy sensors and, in two systems of three, with masses and dampings "
    "that are off. The faults are built with MuJoCo alone, apart from the package's effects and in other ways; the"
)
SOUND = (
    "Robots without a fault, recorded with noisy sensors and, in two systems of three, with masses and dampings that "
    "are off. The"
)
GETS = "diagnosis gets the model, the parameters with bounds and the recordings, and nothing else."
INTRODUCTION = (
    f"{GETS} A cause is right when "
    "the effect named first is the hidden one or declares it indistinguishable; `alone` leaves those sets out. Sizes "
    "are root mean squares over windows of ten steps, over the noise of such a prediction, after the free parameters "
    "have taken what they can. Errors of values are relative to the value, of factors to their distance from 1, of "
    "vectors to their length, where a tenth of that shows with ten standard errors beside all other unknowns. Gaps are "
    "shares of the gap before; the true robot's is from states as measured, which a smoother of states can undercut."
)


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """All figures as plain JSON values."""
    return {
        "figures": [
            {"name": name, "target": target, "value": value, "cases": n, "met": met}
            for name, target, value, n, met in figures(rows)
        ],
        "at_floor": at_floor(rows),
        "coverage": [{"of": name, "share": share, "values": n} for name, share, n in coverage(rows)],
        "by_size": by_size(rows),
        "by_effect": by_effect(rows),
        "by_robot": by_robot(rows),
        "confusion": confusion(rows),
    }


def table(rows: Sequence[Row], facts: Mapping[str, Any], curve: str) -> str:
    """The Markdown page.

    Args:
        rows: one a case.
        facts: command, seed, code, versions, machine and device, and how many cases there are when all are finished.
        curve: file name of the picture.
    """
    failed, hidden = [row for row in rows if not row.right], faulty(rows)
    return "\n".join(
        [
            "# Diagnosis of hidden faults" if hidden else "# Diagnosis of sound robots",
            "",
            f"{ROBOTS if hidden else SOUND} {INTRODUCTION if hidden else GETS}",
            "",
            "| figure | wanted | measured | 95 % interval | cases | met |",
            "|---|---|---|---|---|---|",
            *map(_figure, figures(rows)),
            "",
            " ".join(_told(rows, facts["cases"])),
            "",
            f"Stated 95 % intervals hold the true value in {_coverage(rows)}.",
            "",
            *(_by_fault(rows, curve) if hidden else []),
            "## By robot",
            "",
            "| robot | cases | right | seconds, median |",
            "|---|---|---|---|",
            *(
                f"| {r['robot']} | {r['cases']} | {_percent(r['right'])} | {_plain(r['seconds'])} |"
                for r in by_robot(rows)
            ),
            "",
            "## What was named for what",
            "",
            "| hidden | named first |",
            "|---|---|",
            *(
                f"| {truth} | {', '.join(f'{named} {n}' for named, n in counts.items())} |"
                for truth, counts in confusion(rows).items()
            ),
            "",
            f"## Cases that are not right ({len(failed)})",
            "",
            "| case | robot | hidden | size | named | verdict | reason |",
            "|---|---|---|---|---|---|---|",
            *map(_failure, failed),
            "",
            f"`{facts['command']}`, seed {facts['seed']}; code {facts['code']}; versions {facts['versions']}; "
            f"{facts['machine']}; simulated on {facts['device']}.",
            "",
        ]
    )


def _told(rows: Sequence[Row], cases: int) -> list[str]:
    """The figures that have no goal, in sentences."""
    one, faulty, told = of_kind(rows, "one"), of_kind(rows, "one", "two"), list[str]()
    if one:
        alone, sets = rate(one, lambda r: r.alone), sum(row.set_size for row in one) / len(one)
        told.append(
            f"Right cause without the declared sets: {_percent(alone)}; effects in a set: {sets:.1f} on average."
        )
    if faulty:
        extra = rate(faulty, lambda r: r.extra > 0)
        told.append(f"More effects accepted than hidden: {_percent(extra)} of the cases that have one or two.")
    if of_kind(rows, "one", "two", "none"):
        told.append(f"Gap at most 1.2 noise floors in the end: {_percent(at_floor(rows))} of all but outsiders.")
    told.append(f"Simulated steps in all: {sum(row.steps for row in rows):.3g}.")
    told.append(f"Cases right: {sum(row.right for row in rows)} of {len(rows)}.")
    return told + ([f"Stopped after {len(rows)} of {cases} systems."] if len(rows) < cases else [])


def _by_fault(rows: Sequence[Row], curve: str) -> list[str]:
    return [
        "## By size of the effect over the noise",
        "",
        f"![accuracy by size]({curve})",
        "",
        "A pair goes by the lesser of its two sizes.",
        "",
        "| size | cases | right cause | right place | error of values, median | pairs | both found | outsiders "
        "| unexplained |",
        "|---|---|---|---|---|---|---|---|---|",
        *map(_size, by_size(rows)),
        "",
        "## By effect",
        "",
        "| hidden | cases | right | alone | right place | error of values, median | size, median | in the set |",
        "|---|---|---|---|---|---|---|---|",
        *map(_effect, by_effect(rows)),
        "",
    ]


def _coverage(rows: Sequence[Row]) -> str:
    return "; in ".join(f"{_percent(share)} of {n} {name}" if n else f"no {name}" for name, share, n in coverage(rows))


def _figure(figure: tuple[str, str, float | None, int, bool | None]) -> str:
    name, target, value, n, met = figure
    share = target.endswith("%") and "error" not in name
    interval = ""
    if value is not None and share:
        low, high = wilson(value, n)
        interval = f"{100 * low:.0f} to {100 * high:.0f} %"
    shown = "" if value is None else f"{100 * value:.1f} %" if target.endswith("%") else f"{value:.3g}"
    return f"| {name} | {target} | {shown} | {interval} | {n} | {'' if met is None else 'yes' if met else 'NO'} |"


def _size(row: Mapping[str, Any]) -> str:
    edge = f"{row['low']:g} to {row['high']:g}" if row["high"] else f"above {row['low']:g}"
    one = " | ".join(_percent(row[key]) for key in ("cause", "place", "value_error"))
    pairs, outsiders = (
        f"{row[n]} | {_percent(row[key])}" for n, key in (("pairs", "both"), ("outsiders", "unexplained"))
    )
    return f"| {edge} | {row['cases']} | {one} | {pairs} | {outsiders} |"


def _effect(row: Mapping[str, Any]) -> str:
    name = row["effect"] + (" (outsider)" if row["kind"] == "outsider" else "")
    cells = [_percent(row[key]) for key in ("cause", "alone", "place", "value_error")]
    return f"| {name} | {row['cases']} | {' | '.join(cells)} | {_plain(row['size'])} | {row['set_size']:.1f} |"


def _failure(row: Row) -> str:
    truth, named = "; ".join(row.truth) or "nothing", "; ".join(row.named) or "nothing"
    size = "; ".join(f"{s:.2g}" for s in row.sizes)
    return f"| {row.index} | {row.robot} | {truth} | {size} | {named} | {row.verdict} | {row.reason} |"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f} %"


def _plain(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
