"""The table of exact transport beside its peers."""

from __future__ import annotations

from typing import Any

from nfpde.bench.ot_wanted import grown, verdicts
from nfpde.bench.peers import PACKAGES

COLUMNS = ("POT", "POT lazy", "SciPy", *PACKAGES)


def line(row: dict[str, Any]) -> str:
    """A case: this package's milliseconds, and how many times longer each peer takes."""
    own = row["seconds"]["nfpde"]
    cells = [f"{row['seconds'][peer] / own:.1f}x" if peer in row["seconds"] else "" for peer in COLUMNS]
    return f"| {row['case']} | {1e3 * own:.2f} | {' | '.join(cells)} | {row['apart']:.0e} | {row['repeats']} |"


def _large(row: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """A line about a case without peers, beside the same case at a quarter of the points."""
    quarter = [
        r for r in rows if (r["n"], r["d"], r["kind"], r["weights"]) == (row["n"] // 4, 6, "gauss", row["weights"])
    ]
    ratio = f"{row['seconds'] / quarter[0]['seconds']['nfpde']:.1f}" if quarter else ""
    return f"| {row['case']} | {row['seconds']:.2f} | {ratio} | {grown(row['megabytes']).removesuffix(' MB')} |"


def _threads(solved: dict[str, Any]) -> str:
    """A line about the threads of a case."""
    rows = solved["rows"]
    each = [f"{r['threads']}: {rows[0]['seconds'] / r['seconds']:.2f}x" for r in rows[1:]]
    same = "yes" if all(r["same_bits"] for r in rows) else "NO"
    return f"| {solved['case']} | {rows[0]['seconds']:.2f} | {', '.join(each) or 'one core'} | {same} |"


def table(
    rows: list[dict[str, Any]],
    large: list[dict[str, Any]],
    threads: list[dict[str, Any]],
    facts: dict[str, Any],
    limits: tuple[float, int],
) -> str:
    """The Markdown page.

    Args:
        rows: cases beside peers.
        large: cases without them.
        threads: wall times by threads.
        facts: command, seed, versions, machine.
        limits: seconds from which a peer runs once, and points up to which every run follows an untimed one.
    """
    slow, warm = limits
    lost = [r["case"] for r in rows if any(t < r["seconds"]["nfpde"] for t in r["seconds"].values())]
    worst = max(r["apart"] for r in rows)
    return "\n".join(
        [
            "# Exact optimal transport",
            "",
            "From points to the exact Euclidean cost, one thread, median CPU time of interleaved runs in one process. "
            "Peers: how many times longer they take, the distance matrix (SciPy's) included; POT with numItermax=1e9, "
            f"because its default stops early at large sizes; a peer that takes {slow:.0f} s runs once; "
            f"up to {warm} points every timed run follows an untimed one of the same solver; "
            "lapjv, lapx (lapjvr) and Wasserstein in a process of their own, in turn with the others. "
            "`apart`: largest relative difference of the costs.",
            "",
            f"| case | nfpde, CPU ms | {' | '.join(COLUMNS)} | apart | repeats |",
            "|---" * (len(COLUMNS) + 4) + "|",
            *map(line, rows),
            "",
            f"Slower than a peer in {len(lost)} of {len(rows)} cases" + (f": {'; '.join(lost)}." if lost else "."),
            f"All costs agree to {worst:.0e}, relative.",
            "",
            "| wanted of | at least, at most | measured | |",
            "|---|---|---|---|",
            *verdicts(rows, large),
            "",
            *(
                [
                    "One solve in a process of its own, without peers:",
                    "",
                    "| case | nfpde, CPU s | times n=5000 | peak memory grows by MB |",
                    "|---|---|---|---|",
                    *(_large(row, rows) for row in large),
                    "",
                    "Wall time by threads, in turn, as many times faster than one. They share the passes over all "
                    "pairs, not the search along paths:",
                    "",
                    "| case | one thread, s | threads | same bits |",
                    "|---|---|---|---|",
                    *map(_threads, threads),
                    "",
                ]
                if large
                else []
            ),
            f"`{facts['command']}`, seed {facts['seed']}; versions {facts['versions']}; {facts['machine']}.",
            "",
        ]
    )
