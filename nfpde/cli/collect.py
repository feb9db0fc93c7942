"""`nfpde collect`: record benchmark data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nfpde.benchmarks import BENCHMARKS, Target, collect, robot
from nfpde.dataset import save_dataset


def command(
    name: Annotated[str, typer.Argument(metavar="ROBOT", help=f"one of: {', '.join(BENCHMARKS)}")],
    out: Annotated[Path, typer.Option(help="folder for data.npz, truth.json and parameters.toml")],
    target: Annotated[Target, typer.Option(help="population that the robots are drawn from")] = "gaussian",
    episodes: Annotated[int, typer.Option(help="robots, one episode each")] = 10,
    steps: Annotated[int, typer.Option(help="longest episode, in control steps")] = 150,
    seed: Annotated[int, typer.Option(help="of robots, first states and commands")] = 0,
) -> None:
    """Record random episodes of benchmark robots whose parameters come from a known population.

    The truth is written to a file of its own; nothing but `nfpde evaluate` reads it.
    """
    chosen = robot(name)
    dataset, truth = collect(chosen, target, episodes=episodes, steps=steps, seed=seed)
    out.mkdir(parents=True, exist_ok=True)
    save_dataset(dataset, out / "data.npz")
    truth.save(out / "truth.json")
    chosen.space.to_toml(out / "parameters.toml")
    typer.echo(f"{dataset}\n{out / 'data.npz'}: the recordings")
    typer.echo(f"{out / 'truth.json'}: the robots' true parameters, for nfpde evaluate only")
    typer.echo(f"{out / 'parameters.toml'}: which parameters are unknown, with their bounds")
