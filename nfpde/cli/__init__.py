"""The command line: each command is one call of the library."""

from __future__ import annotations

import sys
from typing import Any, NoReturn

from nfpde.starting import end_early, stopped_early

try:
    import typer

    from nfpde.cli import bench, collect, diagnose, evaluate, fit, train
    from nfpde.cli.stopping import stoppable
    from nfpde.errors import NfpdeError
except KeyboardInterrupt:
    stopped_early()

BadCommandLine: type[Exception] = typer.BadParameter.__mro__[2]
"""What is wrong with a command line itself; typer does not export it."""

app = typer.Typer(
    name="nfpde",
    help="Distributions over a MuJoCo model's parameters from logs of real robots.",
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
    """Run a command; an error is one clear line and exit status 1, of the command line itself 2, an interrupt 130."""
    try:
        status = app(sys.argv[1:] or ["--help"], prog_name="nfpde", standalone_mode=False)
    except KeyboardInterrupt:
        end_early()
    except BadCommandLine as error:
        _refuse(error)
    except NfpdeError as error:
        print(f"nfpde: {error}".rstrip(), file=sys.stderr)  # a message of MuJoCo's ends with empty lines
        sys.exit(1)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"nfpde: {where}{error.strerror or error}", file=sys.stderr)
        sys.exit(1)
    if status or not sys.argv[1:]:
        sys.exit(status or 2)


def _refuse(error: Any) -> NoReturn:
    """Say what the command line's options rule out."""
    context = getattr(error, "ctx", None)
    hint = f"; {context.command_path} --help explains all options" if context is not None else ""
    text = " ".join(error.format_message().split()).rstrip(".")
    print(f"nfpde: {text[:1].lower()}{text[1:]}{hint}", file=sys.stderr)
    sys.exit(error.exit_code)
