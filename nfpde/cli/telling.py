"""Says what long work is doing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape


@contextmanager
def telling(quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """A function to tell with: a spinner on a terminal, a line each elsewhere, nothing if `quiet`."""
    console = Console(stderr=True, quiet=quiet)
    if not console.is_terminal:
        yield lambda what: console.print(what, markup=False)
        return
    with console.status("reading") as status:
        yield lambda what: status.update(escape(what))
