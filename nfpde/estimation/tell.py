"""What a fit found, in a few lines for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from nfpde.estimation.result import FitResult

MOST = 5
"""Lines of each kind."""


def tell(result: FitResult) -> Iterator[str]:
    """Lines on what the recordings tell of each parameter, what only together, and what to record next.

    Args:
        result: of `fit` with the method `trajectory`.
    """
    tells, found = result.info["tells"], result.info["population"]
    yield from _lines("Beware:", result.info.get("cautions", []))  # results of earlier versions have none
    yield "What the recordings tell of each robot:"
    width = max(len(name) for name in tells["parameters"])
    for name, row in tells["parameters"].items():
        yield f"  {name:<{width}}  {row['words']}"
    together = [row["words"] for row in tells["combinations"]]
    yield from _lines("Known only together:", together)
    yield from _lines("To learn the rest:", [row["words"] for row in result.info["record_next"]])
    leaning = sorted(
        {
            f"{name} on its {p['leans_on']} bound"
            for robot in result.info["robots"]
            for name, p in robot["parameters"].items()
            if p["leans_on"]
        }
    )
    yield from _lines("Robots lean on bounds, which may be too tight:", leaning)
    if found["candidates"]:
        yield (
            f"The population ({found['chosen']}) predicts robots left out {found['held_out']:.2f} "
            f"± {found['held_out_error']:.2f} nats better than the bounds alone."
        )


def _lines(title: str, texts: list[str]) -> Iterator[str]:
    if texts:
        yield title
        yield from (f"  {text}" for text in texts[:MOST])
        if len(texts) > MOST:
            yield f"  and {len(texts) - MOST} more in fit.json"
