"""Help of the command line: every command, argument and option is explained."""

from typing import Any
from unittest import mock

import pytest
import typer

from nfpde.cli import app
from tests.command_line import plain, run


def commands(group: Any = None, path=()):
    """Every command with its path."""
    group = group or typer.main.get_command(app)
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*path, name))
        else:
            yield (*path, name), command


@pytest.mark.parametrize(("path", "command"), [*commands()], ids=lambda v: "-".join(v) if isinstance(v, tuple) else "")
def test_help(path, command):
    """Every argument and option of every command is explained, and so is the command."""
    with mock.patch("typer.rich_utils.MAX_WIDTH", 250):  # no help text over several lines
        status, out, _ = run(*path, "--help")
    assert status == 0
    assert command.help
    for parameter in command.params:
        assert parameter.help, parameter.name
        assert len(parameter.help) > 5
        assert plain(parameter.help) in plain(out), parameter.name


def test_help_names_the_commands():
    """Without arguments and with --help alike."""
    for arguments in ((), ("--help",)):
        _, out, err = run(*arguments)
        for name in ("collect", "fit", "evaluate", "train", "bench"):
            assert name in out + err
