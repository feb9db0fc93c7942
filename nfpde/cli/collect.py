"""`nfpde collect`: record benchmark data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nfpde.benchmarks import BENCHMARKS, Target, collect, robot
from nfpde.cli.hidden import read_hidden
from nfpde.dataset import save_dataset


def command(
    name: Annotated[str, typer.Argument(metavar="ROBOT", help=f"one of: {', '.join(BENCHMARKS)}")],
    out: Annotated[Path, typer.Option(help="folder for data.npz, truth.json and parameters.toml")],
    target: Annotated[Target, typer.Option(help="population that the robots are drawn from")] = "gaussian",
    episodes: Annotated[int, typer.Option(help="number of episodes")] = 10,
    robots: Annotated[
        int | None, typer.Option(help="number of robots, which take the episodes in turn; by default one an episode")
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            help="what all robots have and the model lacks: name, element where it acts on one, and values, as in "
            "'coulomb_friction hinge torque=0.2'; may be given again"
        ),
    ] = None,
    noise: Annotated[
        float, typer.Option(help="standard deviation of the sensors' noise, in those of each channel")
    ] = 0.0,
    steps: Annotated[int, typer.Option(help="longest episode, in control steps")] = 150,
    seed: Annotated[int, typer.Option(help="of robots, first states and commands")] = 0,
) -> None:
    """Record random episodes of benchmark robots whose parameters come from a known population.

    The truth is written to a file of its own; nothing but `nfpde evaluate` and `nfpde train`, for the target, read
    it.
    """
    chosen = robot(name)
    hidden = [read_hidden(chosen.model, text) for text in effect or ()]
    dataset, truth = collect(
        chosen, target, episodes=episodes, steps=steps, seed=seed, robots=robots, effects=hidden, noise=noise
    )
    out.mkdir(parents=True, exist_ok=True)
    save_dataset(dataset, out / "data.npz")
    truth.save(out / "truth.json")
    chosen.space.to_toml(out / "parameters.toml")
    typer.echo(f"{dataset}\n{out / 'data.npz'}: the recordings")
    typer.echo(f"{out / 'truth.json'}: the robots' true parameters, for nfpde evaluate and as nfpde train's target")
    typer.echo(f"{out / 'parameters.toml'}: which parameters are unknown, with their bounds")
