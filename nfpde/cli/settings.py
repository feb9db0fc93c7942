"""Command-line options made from a settings dataclass: one option per field, its help text beside it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from typing import Annotated, Any, get_type_hints

import typer


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
        for config in configs:
            types = get_type_hints(config)
            for f in fields(config):
                option = typer.Option(help=f.metadata["help"], rich_help_panel=config.__name__)
                annotation = Annotated[types[f.name], option]
                added.append(
                    inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=annotation)
                )
        command.__signature__ = signature.replace(parameters=[*own, *added])  # type: ignore[attr-defined]
        command.__annotations__ = {p.name: p.annotation for p in [*own, *added]}
        return command

    return decorate


def build(config: type, values: dict[str, Any]) -> Any:
    """The settings object of the options that a command received."""
    return config(**{f.name: values[f.name] for f in fields(config)})
