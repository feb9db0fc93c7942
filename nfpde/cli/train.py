"""`nfpde train`: a policy for robots drawn from a fitted distribution."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from nfpde.cli.fitted import check_model, find_distribution
from nfpde.distribution import ParameterDistribution
from nfpde.truth import Truth


def command(
    env: Annotated[
        str,
        typer.Argument(
            metavar="ENV", help="pendulum, payload, hopper, walker2d, half_cheetah, humanoid or a Gymnasium id"
        ),
    ],
    distribution: Annotated[Path, typer.Option(help="what nfpde fit wrote, or a saved distribution")],
    out: Annotated[Path, typer.Option(help="folder for the policy; an interrupted training goes on from it")],
    steps: Annotated[int, typer.Option(help="control steps in all")] = 20_000,
    model: Annotated[
        Path | None, typer.Option(help="MJCF file to use in the environment, in place of its own: the one fitted")
    ] = None,
    another_model: Annotated[
        bool, typer.Option("--another-model", help="the environment's model may differ from the one fitted")
    ] = False,
    truth: Annotated[Path | None, typer.Option(help="truth.json: evaluate on these robots, the target")] = None,
    evaluation_every: Annotated[int, typer.Option(help="control steps between evaluations and checkpoints")] = 5000,
    evaluation_episodes: Annotated[
        int, typer.Option(help="episodes of an evaluation; robots beyond are left out")
    ] = 20,
    nominal_baseline: Annotated[bool, typer.Option(help="also train on the nominal model, and compare")] = False,
    past_commands: Annotated[
        int | None,
        typer.Option(help="own last commands that the policy sees; by default as many as delays hold back"),
    ] = None,
    seed: Annotated[int, typer.Option(help="of everything random")] = 0,
    device: Annotated[
        Literal["auto", "cpu", "cuda"], typer.Option(help="for the networks; auto is CUDA where there is one")
    ] = "auto",
    quiet: Annotated[bool, typer.Option(help="show no progress")] = False,
) -> None:
    """Train a policy by soft actor-critic on robots drawn anew from a distribution at every reset.

    Writes the policy, train.json and returns.png. The same command goes on where an interrupted one stopped.
    """
    from nfpde.rl import train_sac  # stable-baselines3 takes seconds to import

    folder, fit = find_distribution(distribution)
    fitted = ParameterDistribution.load(folder)
    if fit is not None and not another_model:
        check_model(fit, env, model, fitted.space)
    result = train_sac(
        env,
        fitted,
        steps=steps,
        out=out,
        seed=seed,
        target=None if truth is None else Truth.load(truth),
        evaluation_every=evaluation_every,
        evaluation_episodes=evaluation_episodes,
        nominal_baseline=nominal_baseline,
        model=model,
        device=device,
        past_commands=past_commands,
        quiet=quiet,
    )
    typer.echo(result.summary())
    typer.echo(f"{out / 'policy.safetensors'}: the policy; nfpde.rl.load_policy reads the folder")
    typer.echo(f"{out / 'train.json'}: settings and all returns")
    typer.echo(f"{out / 'returns.png'}: returns in training and in the target")
