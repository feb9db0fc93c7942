"""`nfpde diagnose`: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from nfpde.cli.models import DEVICE_HELP, DIFFERENTIATE_HELP, MODEL_HELP, model_file, read_dataset
from nfpde.cli.telling import telling
from nfpde.errors import BadInput
from nfpde.explained import explained_space
from nfpde.gap import GapReport, Journal, diagnose_gap, write_report
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device


def command(
    model: Annotated[str, typer.Argument(metavar="MODEL", help=f"the nominal model: {MODEL_HELP}")],
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="recordings of a robot: .npz, .csv, .parquet, or a folder")
    ],
    out: Annotated[Path, typer.Option(help="folder for the results; an interrupted diagnosis goes on from it")],
    params: Annotated[
        Path | None, typer.Option(help="parameters.toml: what may vary, within which bounds; without it nothing may")
    ] = None,
    resample: Annotated[
        float | None, typer.Option(help="control step to resample uneven recordings to, in seconds")
    ] = None,
    differentiate: Annotated[bool, typer.Option(help=DIFFERENTIATE_HELP)] = False,
    robot: Annotated[str | None, typer.Option(help="label of the robot that is meant, where there are several")] = None,
    windows: Annotated[
        int | None,
        typer.Option(min=40, help="windows used of each half, 80 to 160 if not given: more are slower and surer"),
    ] = None,
    device: Annotated[Device, typer.Option(help=DEVICE_HELP)] = "auto",
    seed: Annotated[int, typer.Option(min=0, help="decides which episodes are held out")] = 0,
    quiet: Annotated[bool, typer.Option(help="show no progress")] = False,
) -> None:
    """Diagnose the gap between a model and recordings: where it lies, which effects cause it, how far it shrinks.

    Writes diagnosis.json, report.html (opens offline) and summary.png, and where the gap is explained explained.toml:
    the parameters for `nfpde fit`, those of the effects found among them. The same command goes on where an interrupted
    one stopped.
    """
    space = None if params is None else ParameterSpace.from_toml(params)
    dataset = read_dataset(data, resample, differentiate, model)
    nominal = model_file(model)
    explained = out / "explained.toml"
    if params is not None and params.resolve() == explained.resolve():
        raise BadInput(f"{params} is what the diagnosis of {out} writes; give another folder for this one")
    # a folder that cannot be made is told before minutes of work
    with telling(quiet) as tell, Journal(out, tell) as journal:
        found = diagnose_gap(
            nominal,
            dataset,
            space,
            seed=seed,
            windows=windows,
            device=device,
            robot=robot,
            journal=journal,
            report=tell,
        )
        path, page = found.save(out), write_report(found, out)
    for line in found.summary:
        typer.echo(line)
    typer.echo(f"{path}: the answer, for machines")
    typer.echo(f"{page}: the answer, with pictures")
    if _write_explained(found, space, explained):
        call = ["nfpde", "fit", model, str(data), "--params", str(explained)]
        call += [] if resample is None else ["--resample", f"{resample:g}"]
        call += ["--differentiate"] if differentiate else []
        call += [] if robot is None else ["--robot", robot]
        typer.echo(f"{explained}: what to fit next: {shlex.join(call)} --out ...")
    typer.echo(f"simulated on {found.device}")


def _write_explained(found: GapReport, space: ParameterSpace | None, path: Path) -> bool:
    """Write the parameters of the next fit, if there are any; none of an earlier diagnosis may pass for them."""
    path.unlink(missing_ok=True)
    if found.verdict == "unexplained" or not (found.effects or space):
        return False
    explained_space(found, space).to_toml(path)
    return True
