"""`nfpde` run from within a test: its exit status and what it says, and sizes of a fit that is over in a second."""

import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from unittest import mock

from nfpde.cli import main

SIZES = {"iterations": 3, "samples": 30, "transitions": 8, "gradient-steps": 2, "transforms": 2, "hidden": 8}
TINY = [
    "--quiet",
    "--method",
    "softmax",
    *(text for name, value in SIZES.items() for text in (f"--{name}", str(value))),
]


def run(*arguments):
    """Exit status, standard output and standard error of `nfpde ARGUMENTS`."""
    out, err = StringIO(), StringIO()
    argv = ["nfpde", *map(str, arguments)]
    with mock.patch.object(sys, "argv", argv), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
            status = 0
        except SystemExit as stop:
            status = stop.code or 0
    return status, out.getvalue(), err.getvalue()


def plain(text):
    """Words of a text without the frames around it."""
    return " ".join(text.translate(dict.fromkeys(map(ord, "│╭╮╰╯─"), " ")).split())
