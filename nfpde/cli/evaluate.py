"""`nfpde evaluate`: a fitted distribution against the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from nfpde.distribution import ParameterDistribution
from nfpde.errors import BadInput, NfpdeError
from nfpde.estimation.accuracy import Accuracy, accuracy
from nfpde.estimation.result import SCHEMA_VERSION
from nfpde.evaluate import evaluate
from nfpde.parameters import ParameterSpace
from nfpde.storage import read_json, write_whole
from nfpde.truth import Truth


def command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="what nfpde fit wrote")],
    truth: Annotated[Path, typer.Option(help="truth.json of the recordings")],
    samples: Annotated[int, typer.Option(help="samples of each distribution")] = 2000,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="of the samples")] = 0,
) -> None:
    """Measure a fitted distribution against the true parameters: exact optimal transport, coverage, a picture.

    Of a fit by whole trajectories also every robot's errors, beside the Cramer-Rao bounds of its recordings.

    Writes evaluation.json and evaluation.png into DIR.
    """
    estimate = ParameterDistribution.load(folder / "distribution")
    initial = ParameterDistribution.load(folder / "initial", estimate.space)
    recorded = Truth.load(truth)
    known = _over(recorded, estimate.space, truth)
    fit = read_json(folder / "fit.json", SCHEMA_VERSION) if (folder / "fit.json").exists() else {}
    _check_recordings(fit.get("dataset"), folder / "fit.json", truth, known.dataset)
    result = evaluate(estimate, recorded, initial=initial, samples=samples, seed=seed)
    robots = _accuracy(fit, folder / "fit.json", known)
    figures = result.to_json() | ({} if robots is None else {"robots": robots.to_json()})
    write_whole(folder / "evaluation.json", json.dumps(figures, indent=1))
    picture = result.draw(folder / "evaluation.png")
    console = Console()
    console.print(result)
    if robots is not None:
        console.print(robots)
    before, after = result.to_episodes["initial"], result.to_episodes["estimate"]
    typer.echo(
        f"Exact OT distance to the robots' true parameters: {before.physical:.3g} before the fit, "
        f"{after.physical:.3g} after it ({after.physical / before.physical:.0%})"
    )
    typer.echo(f"{folder / 'evaluation.json'}: all figures")
    typer.echo(f"{picture}: the distribution, the robots' true parameters (points) and their population (outlines)")


def _accuracy(fit: dict[str, Any], path: Path, known: Truth) -> Accuracy | None:
    try:
        return accuracy(fit.get("robots", []), known)
    except (TypeError, ValueError, LookupError, AttributeError):
        raise BadInput(
            f"{path}: the entry 'robots' is not what nfpde fit writes (a list with robot, episodes and parameters of "
            "each); fit again, or move the file away to measure the distribution alone"
        ) from None


def _over(known: Truth, space: ParameterSpace, path: Path) -> Truth:
    try:
        return known.over(space)
    except NfpdeError as error:
        raise type(error)(f"{path}, beside the parameters of the fit: {error}") from None


def _check_recordings(fitted: object, fit: Path, truth: Path, recorded: str | None) -> None:
    """Refuse the truth of other recordings than those of the fit, where both files say which theirs are."""
    if fitted is not None and recorded is not None and fitted != recorded:
        raise BadInput(
            f"{truth} is not the truth of the recordings of {fit}: their content hashes are {recorded[:12]}... and "
            f"{str(fitted)[:12]}...; give the truth.json that was written with the fit's recordings. If the fit used "
            "the same recordings in another form (resampled, a part of them, columns renamed), delete the entry "
            f"'dataset' from {truth.name}"
        )
