"""The texts of a command line, as cells or as problems of the calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nfpde.bench.estimation.calibration import calibrate
from nfpde.bench.estimation.grid import run
from nfpde.errors import BadInput
from nfpde.sim import Device

TYPES: dict[str, Callable[[str], Any]] = {"robots": str, "targets": str, "noises": float, "seeds": int}


def command(
    lists: Mapping[str, str | None],
    out: Path,
    *,
    calibration: bool,
    problems: int,
    quick: bool,
    refit: bool,
    budget_minutes: float | None,
    device: Device = "cpu",
) -> bool:
    """Run what the options ask for; see `run` and `calibrate`.

    Args:
        lists: `robots`, `targets`, `noises` and `seeds`, each a text with commas, or None for the default.
        out: folder of the tables.
        calibration: `calibrate` instead of `run`.
        problems: of the calibration.
        quick: tiny sizes.
        refit: fit anew by trajectory what other code fitted.
        budget_minutes: when to stop.
        device: where fits are simulated.

    Raises:
        BadInput: an entry that is no number where one is needed.
    """
    given = {name: split(name, text) for name, text in lists.items() if text is not None}
    if calibration:
        robots = {"robots": given["robots"]} if "robots" in given else {}
        return calibrate(out, problems=problems, quick=quick, budget_minutes=budget_minutes, device=device, **robots)
    return run(out, quick=quick, refit=refit, budget_minutes=budget_minutes, device=device, **given)


def split(name: str, text: str) -> list[Any]:
    """The entries of a list with commas.

    Raises:
        BadInput: naming the entry that is no number, or an empty list.
    """
    entries = [entry.strip() for entry in text.split(",") if entry.strip()]
    if not entries:
        raise BadInput(f"{name} is empty; give at least one, with commas between")
    found = []
    for entry in entries:
        try:
            found.append(TYPES[name](entry))
        except ValueError:
            kind = "an integer" if TYPES[name] is int else "a number"
            raise BadInput(f"{name}: {entry!r} is not {kind}; give a list with commas, like 0,1") from None
    return found
