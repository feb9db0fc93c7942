"""The command line: each command is one call of the library."""

from __future__ import annotations

import sys

import typer

from nfpde.cli import bench, collect, evaluate, fit, train
from nfpde.errors import NfpdeError

app = typer.Typer(
    name="nfpde",
    help="Distributions over a MuJoCo model's parameters from logs of real robots.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command("collect")(collect.command)
app.command("fit")(fit.command)
app.command("evaluate")(evaluate.command)
app.command("train")(train.command)
app.add_typer(bench.app, name="bench")


def main() -> None:
    """Run a command; an error is one clear line and exit status 1, an interrupt 130."""
    try:
        app()
    except NfpdeError as error:
        print(f"nfpde: {error}", file=sys.stderr)
        sys.exit(1)
    except OSError as error:
        print(f"nfpde: {error.filename or ''}: {error.strerror or error}", file=sys.stderr)
        sys.exit(1)
