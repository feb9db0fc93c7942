"""Command-line options made from a settings dataclass: one option per field, its help text beside it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from dataclasses import fields
from typing import Annotated, Any, get_type_hints

import typer

from nfpde.errors import BadInput


def options_from(*configs: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator: add an option for every field of the settings classes to a command.

    The command receives them as keyword arguments by the names of the fields; `build` makes the settings of them.
    Help texts are the fields' metadata entry `help`.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command)
        own = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        hints = get_type_hints(command, include_extras=True)
        own = [p.replace(annotation=hints[p.name]) for p in own]
        added = []
        for name, owners in _owners(configs).items():
            first = owners[0]
            f = next(f for f in fields(first) if f.name == name)
            panel = "Settings of " + " and ".join(config.__name__.removesuffix("Config") for config in owners)
            option = typer.Option(help=f.metadata["help"], rich_help_panel=panel)
            annotation = Annotated[get_type_hints(first)[name], option]
            added.append(
                inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=annotation)
            )
        command.__signature__ = signature.replace(parameters=[*own, *added])  # type: ignore[attr-defined]
        command.__annotations__ = {p.name: p.annotation for p in [*own, *added]}
        return command

    return decorate


def build(config: type, values: dict[str, Any], context: typer.Context, what: str) -> Any:
    """The settings object of the options that a command received.

    Args:
        config: the settings class.
        values: all options of `options_from`.
        context: of the command; tells which options were given.
        what: what the settings are for, for the error.

    Raises:
        BadInput: an option was given that only other settings classes have, or a value breaks a rule.
    """
    own = {f.name for f in fields(config)}
    refuse_idle(context, (name for name in values if name not in own), what)
    return config(**{name: values[name] for name in own})


def refuse_idle(context: typer.Context, names: Iterable[str], what: str) -> None:
    """Refuse options that were given and would do nothing.

    Args:
        context: of the command; tells which options were given.
        names: of the options, as parameters of the command.
        what: what does not heed them, for the error.

    Raises:
        BadInput: one of them was given.
    """
    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            option = "--" + name.replace("_", "-")
            raise BadInput(f"{option} is no setting of {what}, where it would do nothing; leave it out")


def _owners(configs: tuple[type, ...]) -> dict[str, list[type]]:
    """Names of all fields, and which classes have them; a shared name means the same thing in each."""
    owners: dict[str, list[type]] = {}
    for config in configs:
        for f in fields(config):
            owners.setdefault(f.name, []).append(config)
    return owners
