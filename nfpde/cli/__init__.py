"""The command line: each command is one call of the library."""

from __future__ import annotations

import sys

import typer

from nfpde.cli import bench, collect, diagnose, evaluate, fit, train
from nfpde.cli.stopping import stoppable
from nfpde.errors import NfpdeError

app = typer.Typer(
    name="nfpde",
    help="Distributions over a MuJoCo model's parameters from logs of real robots.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command("collect")(stoppable(collect.command))
app.command("fit")(stoppable(fit.command))
app.command("evaluate")(stoppable(evaluate.command))
app.command("diagnose")(stoppable(diagnose.command))
app.command("train")(stoppable(train.command))
app.add_typer(bench.app, name="bench")


def main() -> None:
    """Run a command; an error is one clear line and exit status 1, an interrupt 130."""
    try:
        app()
    except NfpdeError as error:
        print(f"nfpde: {error}".rstrip(), file=sys.stderr)  # a message of MuJoCo's ends with empty lines
        sys.exit(1)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"nfpde: {where}{error.strerror or error}", file=sys.stderr)
        sys.exit(1)
