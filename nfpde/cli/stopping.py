"""What an interrupt of a command looks like."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from typing import Any

import typer


def stoppable(command: Callable[..., None]) -> Callable[..., None]:
    """Decorator: an interrupt of the command is one line, which says how to go on, and exit status 130."""

    @wraps(command)
    def stopping(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except KeyboardInterrupt as stop:
            text = str(stop).replace("the same call", "the same command") or "interrupted; give the same command again"
            print(f"nfpde: {text}", file=sys.stderr)
            raise typer.Exit(130) from None

    return stopping
