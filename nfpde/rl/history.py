"""What a training leaves: its evaluations, its policy, and both as files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nfpde.rl.policy import Policy
from nfpde.storage import write_whole

SCHEMA_VERSION = 1
JSON_FILE = "train.json"


@dataclass(frozen=True)
class Score:
    """Returns of some episodes without exploration, their mean and its standard error.

    All evaluations of trainings with one seed run the same episodes, so that their returns can be compared one by
    one. Where an episode diverged there are no returns, mean and error are None, and `problem` says what happened.
    """

    mean: float | None
    standard_error: float | None
    returns: tuple[float, ...] = ()
    problem: str | None = None

    def __str__(self) -> str:
        if self.mean is None or self.standard_error is None:
            return "diverged"
        return f"{self.mean:.4g} ± {self.standard_error:.2g}"

    def ahead_of(self, other: Score) -> tuple[float, float] | None:
        """Mean and standard error of the differences in return on the same episodes; None where one diverged."""
        if not self.returns or not other.returns:
            return None
        difference = np.subtract(self.returns, other.returns)
        return float(difference.mean()), float(difference.std(ddof=1) / np.sqrt(len(difference)))


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
        scores: dict[str, Score | None] = {}
        for key in ("training", "target"):
            score = value[key]
            scores[key] = None if score is None else Score(**{**score, "returns": tuple(score["returns"])})
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

    @property
    def robots(self) -> tuple[int, int] | None:
        """How many of the target's robots the evaluations ran with, and how many it has; None without a target."""
        target = self.settings.get("target")
        if target is None:
            return None
        return min(len(target["xi"]), self.settings["evaluation_episodes"]), len(target["xi"])

    def with_baseline(self, baseline: TrainResult) -> TrainResult:
        """The same, next to a training on the nominal model."""
        return replace(self, baseline=baseline)

    def summary(self) -> str:
        """Returns before and after, a few lines for people."""
        before, after = self.before, self.after
        lines = [f"{after.step} control steps in {self.seconds:.0f} s"]
        if before.target is not None:
            used, robots = self.robots or (0, 0)
            chosen = f" ({used} of its {robots} robots)" if used < robots else ""
            lines.append(f"return in the target:   {before.target} before, {after.target} after{chosen}")
        lines.append(f"return where it trains: {before.training} before, {after.training} after")
        if self.policy.past_commands:
            lines.append(f"the policy sees its own last {self.policy.past_commands} commands behind the observation")
        if self.baseline is not None:
            last = self.baseline.after
            lines.append(f"trained on the nominal model: {last.target or last.training} after")
            ahead = after.target.ahead_of(last.target) if after.target and last.target else None
            if ahead is not None:
                lines.append(f"difference in the target, episode by episode: {ahead[0]:+.3g} ± {ahead[1]:.2g}")
        return "\n".join(lines)


def write_json(result: TrainResult) -> None:
    """Write `train.json` into the result's folder."""
    content: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "settings": dict(result.settings),
        "seconds": result.seconds,
        "points": [asdict(p) for p in result.points],
    }
    if result.robots is not None:
        content["robots"] = dict(zip(("evaluated", "all"), result.robots, strict=True))
    if result.baseline is not None:
        content["nominal_baseline"] = {
            "seconds": result.baseline.seconds,
            "points": [asdict(p) for p in result.baseline.points],
        }
    result.folder.mkdir(parents=True, exist_ok=True)
    write_whole(result.folder / JSON_FILE, json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False))
