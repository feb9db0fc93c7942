"""`nfpde fit`: from recordings to a distribution."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from nfpde.cli.models import DEVICE_HELP, DIFFERENTIATE_HELP, MODEL_HELP, make_simulator, read_dataset
from nfpde.cli.settings import build, options_from, refuse_idle
from nfpde.estimation import CONFIGS, Method, NfpdeConfig, TrajectoryConfig, draw_fit, fit, tell, write_report
from nfpde.sim import Device, runs_on


@options_from(NfpdeConfig, TrajectoryConfig)
def command(
    context: typer.Context,
    model: Annotated[str, typer.Argument(metavar="MODEL", help=MODEL_HELP)],
    data: Annotated[Path, typer.Argument(metavar="DATA", help="recordings: .npz, .csv, .parquet, or a folder of them")],
    out: Annotated[Path, typer.Option(help="folder for the results; an interrupted fit goes on from it")],
    params: Annotated[Path | None, typer.Option(help="parameters.toml; a benchmark robot has its own")] = None,
    method: Annotated[
        Method, typer.Option(help="whole trajectories, or softmax (Eq. 11 of the paper) or cai (Eq. 10)")
    ] = "trajectory",
    resolution: Annotated[
        float | None, typer.Option(help="smallest step that the sensors show, in the recorded units (trajectory only)")
    ] = None,
    resample: Annotated[
        float | None, typer.Option(help="control step to resample uneven recordings to, in seconds")
    ] = None,
    differentiate: Annotated[bool, typer.Option(help=DIFFERENTIATE_HELP)] = False,
    robot: Annotated[
        str | None, typer.Option(help="label of the only robot to fit, where there are several; all without it")
    ] = None,
    device: Annotated[Device, typer.Option(help=DEVICE_HELP)] = "auto",
    seed: Annotated[int, typer.Option(help="of everything random")] = 0,
    quiet: Annotated[bool, typer.Option(help="show no progress")] = False,
    **settings: Any,
) -> None:
    """Fit a distribution over the model's parameters to recordings of one or many robots.

    Writes the distribution, fit.json, corner.png and progress.png, and by trajectory report.html and report.png. The
    same command goes on where an interrupted one stopped.
    """
    simulator = make_simulator(model, params, device)
    dataset = read_dataset(data, resample, differentiate, model)
    dataset = dataset if robot is None else dataset.of_robot(robot)
    if method == "softmax":
        refuse_idle(context, ("clip",), "the method softmax")
    config = build(CONFIGS[method], settings, context, f"the method {method}")
    result = fit(
        simulator, dataset, method=method, config=config, resolution=resolution, seed=seed, out=out, quiet=quiet
    )
    pictures = draw_fit(result, out, nominal=simulator.nominal())
    Console().print(result.distribution.summary(simulator.nominal()))
    if method == "trajectory":
        pictures |= write_report(result, out)
        for line in tell(result):
            typer.echo(line)
    typer.echo(f"{out / 'distribution'}: the distribution; nfpde.ParameterDistribution.load reads it")
    typer.echo(f"{out / 'fit.json'}: settings, counts and the course of the fit")
    for path, text in pictures.items():
        typer.echo(f"{path}: {text}")
    typer.echo(f"simulated on {runs_on(simulator)}")
