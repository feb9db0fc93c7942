"""Files of a system: the public folder that a diagnosis gets, and the key, which nobody but its owner may read."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nfpde.bench.gap.nominal import Free, write_parameters
from nfpde.bench.gap.record import Run
from nfpde.bench.gap.robots import Robot
from nfpde.dataset import Dataset, Episode, save_dataset
from nfpde.storage import write_whole


def write_public(xml: str, free: list[Free], robot: Robot, runs: Sequence[Run], folder: Path) -> None:
    """Write model.xml, parameters.toml (absent where nothing is free) and data.npz."""
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / "model.xml", xml)
    write_parameters(free, folder / "parameters.toml")
    episodes = [
        Episode(
            str(i),
            time=[row * robot.control_dt for row in range(len(run.qpos))],
            qpos=run.qpos,
            qvel=run.qvel,
            ctrl=run.ctrl,
        )
        for i, run in enumerate(runs)
    ]
    save_dataset(Dataset(episodes), folder / "data.npz")


def write_key(key: dict[str, Any], path: Path) -> None:
    """Write the key into a folder that only its owner may enter."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.parent.chmod(0o700)
    write_whole(path, json.dumps(key, indent=1))


def read_key(path: Path) -> dict[str, Any]:
    """Read a key again."""
    return json.loads(path.read_text(encoding="utf-8"))
