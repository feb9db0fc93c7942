"""`nfpde evaluate`: a fitted distribution against the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from nfpde.distribution import ParameterDistribution
from nfpde.evaluate import evaluate
from nfpde.truth import Truth


def command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="what nfpde fit wrote")],
    truth: Annotated[Path, typer.Option(help="truth.json of the recordings")],
    samples: Annotated[int, typer.Option(help="samples of each distribution")] = 2000,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="of the samples")] = 0,
) -> None:
    """Measure a fitted distribution against the true parameters: exact optimal transport, coverage, a picture.

    Writes evaluation.json and evaluation.png into DIR.
    """
    known = Truth.load(truth)
    estimate = ParameterDistribution.load(folder / "distribution", known.space)
    initial = ParameterDistribution.load(folder / "initial", known.space)
    result = evaluate(estimate, known, initial=initial, samples=samples, seed=seed)
    (folder / "evaluation.json").write_text(json.dumps(result.to_json(), indent=1))
    picture = result.draw(folder / "evaluation.png")
    Console().print(result)
    before, after = result.to_episodes["initial"], result.to_episodes["estimate"]
    typer.echo(
        f"Exact OT distance to the robots' true parameters: {before.physical:.3g} before the fit, "
        f"{after.physical:.3g} after it ({after.physical / before.physical:.0%})"
    )
    typer.echo(f"{folder / 'evaluation.json'}: all figures")
    typer.echo(f"{picture}: the distribution, the robots' true parameters (points) and their population (outlines)")
