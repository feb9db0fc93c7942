"""`nfpde bench estimation`: cells of the grid, one file each, and the table of all that are finished."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

from nfpde.bench.estimation.cell import QUICK, TRAJECTORY, Cell, Settings, assemble, facts_of_device, measure
from nfpde.bench.estimation.stages import SCHEMA_VERSION, Budget, OutOfTime, Stages
from nfpde.bench.estimation.table import line, order, row, table
from nfpde.benchmarks import ROBOTS, Target, robot
from nfpde.errors import BadInput
from nfpde.sim import Device, found_device
from nfpde.storage import read_json, write_whole

NOISES = (0.0, 0.001, 0.01)
QUICK_CELLS = [Cell("hopper", "mixture", 0.001, 0)]


def run(
    out: Path,
    *,
    robots: Sequence[str] = tuple(ROBOTS),
    targets: Sequence[str] = get_args(Target),
    noises: Sequence[float] = NOISES,
    seeds: Sequence[int] = (0, 1, 2),
    quick: bool = False,
    refit: bool = False,
    budget_minutes: float | None = None,
    device: Device = "cpu",
) -> bool:
    """Measure the cells that are not finished yet, print their rows, write estimation.md and estimation.json.

    A later call with other cells adds to the same table. Finished cells are kept, whatever code measured them: each
    names its commit, and a file that is deleted is measured anew.

    Args:
        out: folder of the table; the cells lie in `estimation/` in it.
        robots: names, as in `nfpde.benchmarks.ROBOTS`.
        targets: populations.
        noises: of the sensors, in standard deviations of each channel.
        seeds: of recordings, noise and fits; the outermost of the four.
        quick: one tiny cell instead, in `estimation_quick/`.
        refit: fit anew by trajectory where other code did, and keep the fits by softmax.
        budget_minutes: no further fit is begun after so long.
        device: where the fits are simulated; the table of another one than the CPU is `estimation_<device>`.

    Returns:
        Whether all cells asked for are finished.

    Raises:
        BadInput: an unknown robot or target, a noise or seed below zero, or no such device.
    """
    device = found_device(device)
    cells = QUICK_CELLS if quick else _cells(robots, targets, noises, seeds)
    settings = QUICK if quick else Settings()
    name = "estimation" + (f"_{device}" if device != "cpu" else "") + ("_quick" if quick else "")
    folder = out / name
    budget = Budget.of(budget_minutes)
    complete = True
    try:
        for cell in cells:
            where = facts_of_device(robot(cell.robot), device)
            facts = {"cell": asdict(cell), "settings": asdict(settings), **where}
            stages = Stages(folder, str(cell), facts, budget, renew=TRAJECTORY if refit else None)
            if stages.finished() is None:
                measure(cell, settings, stages, device)
                print(line(assemble(stages.finish())), flush=True)
    except OutOfTime:
        complete = False
    finished = _finished(folder, settings)
    if finished:
        command = "nfpde bench estimation"
        command += (f" --device {device}" if device != "cpu" else "") + (" --quick" if quick else "")
        text = table(finished, command)
        print(text)
        write_whole(out / f"{name}.md", text)
        figures = {"command": command, "rows": [row(c) for c in finished]}
        write_whole(out / f"{name}.json", json.dumps(figures, indent=1) + "\n")
    missing = [str(c) for c in cells if str(c) not in {_name(f) for f in finished}]
    print(
        f"{len(cells) - len(missing)} of {len(cells)} cells are finished" + (": give the command again" * bool(missing))
    )
    return complete


def _cells(robots: Iterable[str], targets: Iterable[str], noises: Iterable[float], seeds: Iterable[int]) -> list[Cell]:
    cells = []
    for seed, name, noise, target in itertools.product(seeds, robots, noises, targets):
        robot(name)
        if target not in get_args(Target):
            raise BadInput(f"no target population is called {target!r}; there are: {', '.join(get_args(Target))}")
        if not 0 <= noise < 1:
            raise BadInput(f"noise is {noise:g}; it must be a share of a channel's standard deviation, 0 to 1")
        if seed < 0:
            raise BadInput(f"seed must be at least 0, got {seed}")
        cells.append(Cell(name, target, noise, seed))  # type: ignore[arg-type]
    return cells


def _finished(folder: Path, settings: Settings) -> list[dict[str, Any]]:
    """All cells of the folder that were measured with these settings."""
    wanted = json.loads(json.dumps(asdict(settings)))
    paths = [p for p in folder.glob("*.json") if not p.name.endswith(".part.json")]
    cells = [read_json(path, SCHEMA_VERSION) for path in paths]
    return _alone(sorted((assemble(c) for c in cells if c["facts"].get("settings") == wanted), key=order))


def _alone(cells: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The cells with the fastest rate that any of the same robot and device has measured: what else runs only slows."""
    fastest: dict[tuple[str, str], float] = {}
    for cell in cells:
        kind = cell["cell"]["robot"], cell["device"]
        fastest[kind] = max(fastest.get(kind, 0.0), cell["steps_per_core_second"])
    return [c | {"steps_per_core_second": fastest[c["cell"]["robot"], c["device"]]} for c in cells]


def _name(content: dict[str, Any]) -> str:
    return str(Cell(**content["cell"]))
