"""What a training leaves: its evaluations, its policy, and both as files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from nfpde.rl.policy import Policy

SCHEMA_VERSION = 1
JSON_FILE = "train.json"


@dataclass(frozen=True)
class Score:
    """Mean return of some episodes, without exploration; None where one of them diverged, and `problem` says how."""

    mean: float | None
    standard_error: float | None
    episodes: int
    problem: str | None = None

    def __str__(self) -> str:
        if self.mean is None or self.standard_error is None:
            return "diverged"
        return f"{self.mean:.4g} ± {self.standard_error:.2g}"


@dataclass(frozen=True)
class Point:
    """How training stood after a round.

    step: control steps so far.
    exploring: mean return of the round's `episodes` that ended, with exploration; None where none did.
    diverged: episodes of the round that the simulation's divergence ended.
    training: on parameters as in training.
    target: on the target's parameters, None without a target.
    """

    step: int
    exploring: float | None
    episodes: int
    diverged: int
    training: Score
    target: Score | None

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Point:
        """Read what `dataclasses.asdict` made."""
        scores = {k: None if value[k] is None else Score(**value[k]) for k in ("training", "target")}
        return cls(**{**value, **scores})


@dataclass(frozen=True, eq=False)
class TrainResult:
    """A training: its folder, its settings (JSON), evaluations in order (the first before training), its policy.

    seconds: time training took, all its parts together.
    baseline: the same training on the nominal model, where one was asked for.
    """

    folder: Path
    settings: Mapping[str, Any]
    points: tuple[Point, ...]
    policy: Policy
    seconds: float
    baseline: TrainResult | None = None

    @property
    def before(self) -> Point:
        """Evaluation of the untrained policy."""
        return self.points[0]

    @property
    def after(self) -> Point:
        """Evaluation of the final policy."""
        return self.points[-1]

    def with_baseline(self, baseline: TrainResult) -> TrainResult:
        """The same, next to a training on the nominal model."""
        return replace(self, baseline=baseline)

    def summary(self) -> str:
        """Returns before and after, a few lines for people."""
        before, after = self.before, self.after
        lines = [f"{after.step} control steps in {self.seconds:.0f} s"]
        if before.target is not None:
            lines.append(f"return in the target:   {before.target} before, {after.target} after")
        lines.append(f"return where it trains: {before.training} before, {after.training} after")
        if self.baseline is not None:
            last = self.baseline.after
            lines.append(f"trained on the nominal model: {last.target or last.training} after")
        return "\n".join(lines)


def write_json(result: TrainResult) -> None:
    """Write `train.json` into the result's folder."""
    content: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "settings": dict(result.settings),
        "seconds": result.seconds,
        "points": [asdict(p) for p in result.points],
    }
    if result.baseline is not None:
        content["nominal_baseline"] = {
            "seconds": result.baseline.seconds,
            "points": [asdict(p) for p in result.baseline.points],
        }
    result.folder.mkdir(parents=True, exist_ok=True)
    temporary = result.folder / f"{JSON_FILE}.tmp"
    temporary.write_text(json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False), encoding="utf-8")
    temporary.replace(result.folder / JSON_FILE)
