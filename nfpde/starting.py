"""The first seconds of a command, in which everything is imported."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NoReturn


def stopped_early() -> NoReturn:
    """End a command that was interrupted before it began, with a line and exit status 130; to be called on Ctrl-C.

    Raises:
        SystemExit: this process is the command line.
        KeyboardInterrupt: it is another program, which imports this package and has its own way to stop.
    """
    if not _is_command_line():
        raise  # the interrupt that is being handled
    end_early()


def end_early() -> NoReturn:
    """End the process with a line and exit status 130.

    Raises:
        SystemExit: always.
    """
    print("nfpde: interrupted before it began; give the same command again", file=sys.stderr)
    raise SystemExit(130) from None


def _is_command_line() -> bool:
    """Whether this process is `nfpde` or `python -m nfpde`, which is `-m` until the package is imported."""
    path = Path(sys.argv[0] if sys.argv else "")
    return path.name == "-m" or path.stem == "nfpde" or (path.parent.name, path.name) == ("nfpde", "__main__.py")
