"""`nfpde bench`: measure the package itself; every table names its command, seed and versions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(help="Benchmarks of the package; each prints a table and writes it as Markdown and JSON.")

Quick = Annotated[bool, typer.Option(help="smaller sizes and fewer repeats: minutes instead of tens of minutes")]
Out = Annotated[Path, typer.Option(help="folder for the tables")]


@app.command("losses")
def losses(quick: Quick = False, out: Out = Path("docs/results")) -> None:
    """Simulated transitions per CPU-second beside MuJoCo's own C loop."""
    from nfpde.bench import losses as bench

    bench.run(quick, out)


@app.command("ot")
def ot(
    quick: Quick = False,
    out: Out = Path("docs/results"),
    peers_python: Annotated[
        Path | None, typer.Option(help="Python of an environment with lapjv, lapx and Wasserstein")
    ] = None,
) -> None:
    """Exact optimal transport beside POT and SciPy, and beside solvers of another environment."""
    from nfpde.bench import ot as bench

    bench.run(quick, out, peers_python)


@app.command("fit")
def fit(quick: Quick = False, out: Out = Path("docs/results")) -> None:
    """Softmax and CAI on Hopper, both populations, several seeds: OT to the truth before and after."""
    from nfpde.bench import fit as bench

    bench.run(quick, out)
