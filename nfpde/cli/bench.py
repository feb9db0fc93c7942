"""`nfpde bench`: measure the package itself; every table names its command, seed and versions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from nfpde.cli.models import DEVICE_HELP
from nfpde.cli.settings import refuse_idle
from nfpde.cli.stopping import stoppable
from nfpde.sim import Device, found_device

app = typer.Typer(help="Benchmarks of the package; each prints a table and writes it as Markdown and JSON.")

Quick = Annotated[bool, typer.Option(help="smaller sizes and fewer repeats: minutes instead of tens of minutes")]
Out = Annotated[Path, typer.Option(help="folder for the tables")]
GapKind = Literal["one", "none", "two", "outsider"]


@app.command("losses")
@stoppable
def losses(
    quick: Quick = False,
    out: Out = Path("docs/results"),
    device: Annotated[
        Device, typer.Option(help="cuda: beside MuJoCo Warp's bare stepping; warp-cpu tries the code")
    ] = "cpu",
) -> None:
    """Simulated transitions per CPU-second beside MuJoCo's own C loop, or per second on a GPU."""
    if device == "cpu":
        from nfpde.bench import losses as bench

        bench.run(quick, out)
    else:
        from nfpde.bench import losses_warp

        losses_warp.run(quick, out, device)


@app.command("devices")
@stoppable
def devices(
    quick: Quick = False,
    out: Out = Path("docs/results"),
    device: Annotated[Device, typer.Option(help="cuda; warp-cpu tries the code")] = "cuda",
) -> None:
    """All that is to be measured on a GPU: losses, fits and a diagnosis from end to end, beside the CPU."""
    from nfpde.bench import devices as bench

    bench.run(quick, out, device)


@app.command("ot")
@stoppable
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
@stoppable
def fit(
    quick: Quick = False,
    out: Out = Path("docs/results"),
    device: Annotated[Device, typer.Option(help=f"where fits simulate: {DEVICE_HELP}")] = "cpu",
) -> None:
    """Softmax and CAI on Hopper, both populations, several seeds: OT to the truth before and after."""
    from nfpde.bench import fit as bench

    bench.run(quick, out, device)


@app.command("estimation")
@stoppable
def estimation(
    context: typer.Context,
    robots: Annotated[str | None, typer.Option(help="with commas; all four, for the calibration three")] = None,
    targets: Annotated[str, typer.Option(help="populations, with commas")] = "gaussian,mixture",
    noise: Annotated[str, typer.Option(help="of the sensors, shares of each channel's deviation")] = "0,0.001,0.01",
    seeds: Annotated[str, typer.Option(help="with commas")] = "0,1,2",
    calibration: Annotated[bool, typer.Option(help="coverage of posteriors of random robots instead")] = False,
    problems: Annotated[int, typer.Option(help="random robots of the calibration, of each kind")] = 100,
    quick: Annotated[bool, typer.Option(help="one tiny cell, or a few tiny problems")] = False,
    refit: Annotated[bool, typer.Option(help="fit anew by trajectory what other code fitted, keep softmax")] = False,
    budget_minutes: Annotated[float | None, typer.Option(help="begin no further fit after so long")] = None,
    device: Annotated[Device, typer.Option(help=f"where fits simulate: {DEVICE_HELP}")] = "cpu",
    out: Out = Path("docs/results"),
) -> None:
    """Whole trajectories beside softmax, cell by cell; goes on where it stopped."""
    from nfpde.bench import estimation as bench

    if quick:
        refuse_idle(context, ("robots", "targets", "noise", "seeds", "problems"), "--quick, which has cells of its own")
    if calibration:
        refuse_idle(context, ("targets", "noise", "seeds", "refit"), "--calibration")
    else:
        refuse_idle(context, ("problems",), "the cells, only of --calibration")
    bench.command(
        {"robots": robots, "targets": targets, "noises": noise, "seeds": seeds},
        out,
        calibration=calibration,
        problems=problems,
        quick=quick,
        refit=refit,
        budget_minutes=budget_minutes,
        device=device,
    )


@app.command("gap")
@stoppable
def gap(
    seed: Annotated[int, typer.Option(min=0, help="of the systems; one on which nothing was tried before")],
    cases: Annotated[int, typer.Option(min=1, help="number of systems")] = 300,
    jobs: Annotated[int, typer.Option(min=1, help="systems at a time")] = 1,
    limit: Annotated[float, typer.Option(help="wall seconds for one diagnosis; longer is a failure")] = 300.0,
    folder: Annotated[
        Path | None, typer.Option(help="finished cases and keys; runs/gap-SEED[-KIND] by default")
    ] = None,
    quick: Annotated[bool, typer.Option(help="12 systems at most")] = False,
    out: Annotated[
        Path | None, typer.Option(help="folder for the tables; docs/results/gap_SEED by default", show_default=False)
    ] = None,
    device: Annotated[Device, typer.Option(help=f"where the diagnosis simulates: {DEVICE_HELP}")] = "auto",
    kind: Annotated[GapKind | None, typer.Option(help="faults of every system; 60, 15, 15, 10 % if not given")] = None,
    draw_only: Annotated[bool, typer.Option(help="only write the systems, with keys beside: to develop on")] = False,
) -> None:
    """Hidden faults against `nfpde diagnose`: cause, place, value, false alarms. Go on by the same command."""
    from nfpde.bench.gap import run as bench

    if draw_only:
        folder = folder or bench.default_folder(seed, kind)
        cases = min(cases, bench.QUICK_CASES) if quick else cases
        bench.draw_only(seed, folder / "systems", folder / "keys", cases=cases, kind=kind)
        return
    out = out or Path("docs/results") / f"gap_{seed}"
    bench.run(
        seed,
        out,
        cases=cases,
        jobs=jobs,
        quick=quick,
        limit=limit,
        folder=folder,
        device=found_device(device),
        kind=kind,
    )


@app.command("real")
@stoppable
def real(
    recordings: Annotated[Path, typer.Argument(help="folder with one of each source, see the table")],
    only: Annotated[str, typer.Option(help="beginnings of the cases' names, with commas; all if empty")] = "",
    reports: Annotated[Path | None, typer.Option(help="folder for report.html of every case")] = None,
    windows: Annotated[int | None, typer.Option(min=40, help="as in nfpde diagnose")] = None,
    seed: Annotated[int, typer.Option(min=0, help="decides which episodes are held out")] = 0,
    out: Out = Path("docs/results"),
    device: Annotated[Device, typer.Option(help=f"where the diagnosis simulates: {DEVICE_HELP}")] = "auto",
) -> None:
    """Published recordings of real robots against `nfpde diagnose`, beside what is known of each."""
    from nfpde.bench.real.run import run
    from nfpde.cli.telling import telling

    names = [name.strip() for name in only.split(",") if name.strip()]
    with telling() as tell:
        run(recordings, out, names=names, reports=reports, windows=windows, device=device, seed=seed, report=tell)
