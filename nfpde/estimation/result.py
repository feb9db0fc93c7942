"""What a fit found, and its folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nfpde.distribution import ParameterDistribution
from nfpde.errors import BadInput

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class FitResult:
    """What a fit found.

    Attributes:
        distribution: over the parameters, after the fit.
        initial: the distribution that the fit started from.
        history: one table of figures per iteration.
        info: method, settings, seed, counts, versions; with `trajectory` also what was found of each robot; JSON.
        episodes: with `trajectory`, the equal mixture of the robots' own posteriors: the sharpest answer to which
            robots made the recordings, where `distribution` is smoothed to cover robots not seen.
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
        content = {"schema_version": SCHEMA_VERSION, **self.info, "history": self.history}
        temporary = folder / "fit.json.tmp"
        temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False), encoding="utf-8")
        temporary.replace(folder / "fit.json")

    @classmethod
    def load(cls, folder: str | Path) -> FitResult:
        """Read what `save` wrote.

        Raises:
            BadInput: a file is missing or damaged, or of another version.
        """
        folder = Path(folder)
        path = folder / "fit.json"
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise BadInput(f"{path} cannot be read ({error.strerror}); is this the folder of a fit?") from None
        except ValueError as error:
            raise BadInput(f"{path} is not JSON: {error}") from None
        found = content.pop("schema_version", None) if isinstance(content, dict) else None
        if found != SCHEMA_VERSION or "history" not in content:
            raise BadInput(f"{path}: schema_version is {found!r}, this version of nfpde reads {SCHEMA_VERSION}")
        distribution = ParameterDistribution.load(folder / "distribution")
        initial = ParameterDistribution.load(folder / "initial", distribution.space)
        inner = folder / "episodes"
        episodes = ParameterDistribution.load(inner, distribution.space) if inner.is_dir() else None
        return cls(distribution, initial, content.pop("history"), content, episodes)
