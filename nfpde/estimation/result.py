"""What a fit found, and its folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from nfpde.distribution import ParameterDistribution
from nfpde.distribution.files import JSON_FILE
from nfpde.errors import BadInput
from nfpde.storage import read_json, write_whole

SCHEMA_VERSION = 1


def versions() -> dict[str, str]:
    """Versions of the packages that the numbers depend on."""
    return {name: version(name) for name in ("nfpde", "mujoco", "torch", "zuko", "numpy")}


@dataclass(frozen=True)
class FitResult:
    """What a fit found.

    Attributes:
        distribution: over the parameters, after the fit.
        initial: the distribution that the fit started from.
        history: one table of figures per iteration.
        info: method, settings, seed, counts, versions; with `trajectory` also what was found of each robot; JSON.
        episodes: with `trajectory`, the equal mixture of the robots' posteriors: the sharpest answer to which robots
            made the recordings, where `distribution` is the population, which covers robots not seen.
    """

    distribution: ParameterDistribution
    initial: ParameterDistribution
    history: list[dict[str, float]]
    info: dict[str, Any]
    episodes: ParameterDistribution | None = None

    def save(self, folder: str | Path) -> None:
        """Write `distribution/`, `initial/`, `episodes/` where there is one, and, last, `fit.json`."""
        folder = Path(folder)
        self.distribution.save(folder / "distribution")
        self.initial.save(folder / "initial")
        if self.episodes is not None:
            self.episodes.save(folder / "episodes")
        else:
            # of an earlier fit into the same folder
            ParameterDistribution.remove(folder / "episodes")
        content = {"schema_version": SCHEMA_VERSION, **self.info, "history": self.history}
        write_whole(folder / "fit.json", json.dumps(content, indent=1, ensure_ascii=False))

    @classmethod
    def load(cls, folder: str | Path) -> FitResult:
        """Read what `save` wrote.

        Raises:
            BadInput: a file is missing or damaged, or of another version.
        """
        folder = Path(folder)
        path = folder / "fit.json"
        content = read_json(path, SCHEMA_VERSION, missing="; is this the folder of a fit?")
        del content["schema_version"]
        if "history" not in content:
            raise BadInput(f"{path}: the entry 'history' is missing")
        distribution = ParameterDistribution.load(folder / "distribution")
        initial = ParameterDistribution.load(folder / "initial", distribution.space)
        inner = folder / "episodes"
        episodes = ParameterDistribution.load(inner, distribution.space) if (inner / JSON_FILE).is_file() else None
        return cls(distribution, initial, content.pop("history"), content, episodes)
