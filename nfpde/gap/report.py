"""What a diagnosis says: where the gap lies, which effects cause it, how far it shrinks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset.rows import is_whole_number
from nfpde.storage import finite, write_whole

Array = NDArray[np.float64]
Verdict = Literal["effects", "no_gap", "unexplained"]


@dataclass(frozen=True)
class Fitted:
    """A fitted value with its 95 % interval, in `unit`."""

    value: float
    low: float
    high: float
    unit: str
    at_bound: bool = False
    """The value leans on the end of its admissible range, and does something there: a finding in itself."""

    @property
    def behind(self) -> str:
        """The unit as it is written behind a number: nothing for a mere number."""
        return "" if self.unit in ("", "-") else f" {self.unit}"


@dataclass(frozen=True)
class Rival:
    """Another effect that explains these recordings as well."""

    effect: str
    target: str


@dataclass(frozen=True)
class Cause:
    """An effect on a target, fitted together with everything else.

    Args:
        effect: Name in the effect library; all readings of an effect have its name.
        target: Element it acts on; `all`, `world` or `contact` for an effect on no single one.
        sentence: What the effect is, for a roboticist.
        parameters: Its fitted values by name.
        shrink: Share of the held-out gap that it removed, with its 95 % interval in `shrink_low`, `shrink_high`.
        gain: Held-out log likelihood gained per window [nats], with its standard error in `gain_error`.
        indistinguishable: Effects that these recordings cannot tell from it.
        separating_experiment: What to record to tell them apart; "" where there are none.
        reading: Name under which `nfpde.effect` gives exactly this reading, where engineers mean different things by
            the name; "" for the plain one.
        other_readings: Names of other readings that these recordings cannot tell from it.
    """

    effect: str
    target: str
    sentence: str
    parameters: Mapping[str, Fitted]
    shrink: float
    shrink_low: float
    shrink_high: float
    gain: float
    gain_error: float
    indistinguishable: Sequence[Rival] = ()
    separating_experiment: str = ""
    reading: str = ""
    other_readings: Sequence[str] = ()


@dataclass(frozen=True)
class Place:
    """A joint's share of the gap, noise subtracted, and the regime that its gap singles out."""

    joint: str
    share: float
    regime: str


@dataclass(frozen=True)
class Level:
    """Mean squared whitened residual on held-out episodes, relative to the nominal model's at the same horizon.

    Where the nominal model reproduces the recordings to rounding, relative to what rounding may do: `before` is less
    than 1 then.
    """

    before: float
    after_parameters: float
    after_effects: float
    noise_floor: float


@dataclass(frozen=True)
class Distance:
    """Distances between recorded and simulated states at the ends of held-out windows, by optimal transport.

    Of order 1, in standard deviations of the recorded states; the ladder's rungs as in `Level`, but not relative.

    windows: number of windows compared
    """

    before: float
    after_parameters: float
    after_effects: float
    noise_floor: float
    windows: int


@dataclass(frozen=True, eq=False)
class GapMap:
    """Shares of the gap by joint (rows) and regime (columns), noise subtracted.

    The columns stand in groups, each of which sorts all windows by one question (how the joint moves, what it
    touches, ...) and so splits the same whole: the shares of a group sum to 1.

    joints: names (joints,); regimes: names (regimes,)
    share: (joints, regimes)
    windows: number of windows of both halves (joints, regimes)
    groups: columns of each group by its name, in order; the first is "motion"
    """

    joints: Sequence[str]
    regimes: Sequence[str]
    share: Array
    windows: NDArray[np.intp]
    groups: Mapping[str, int]

    def part(self, group: str) -> Array:
        """Shares of one group (joints, its regimes)."""
        names = list(self.groups)
        first = sum(self.groups[n] for n in names[: names.index(group)])
        return self.share[:, first : first + self.groups[group]]

    def to_json(self) -> dict[str, dict[str, dict[str, float]]]:
        """Shares by group, joint and regime."""
        out, first = {}, 0
        for group, count in self.groups.items():
            names = self.regimes[first : first + count]
            rows = zip(self.joints, self.share[:, first : first + count].tolist(), strict=True)
            out[group] = {joint: dict(zip(names, row, strict=True)) for joint, row in rows}
            first += count
        return out


@dataclass(frozen=True, eq=False)
class Trace:
    """One window: what was measured and what was predicted, of the channel that was worst.

    time: seconds into the episode (H + 1,); the others likewise, in `unit`
    """

    episode: str
    channel: str
    unit: str
    time: Array
    measured: Array
    before: Array
    """With the fitted parameters, without effects."""
    after: Array
    """With parameters and effects."""


@dataclass(frozen=True, eq=False)
class ResidualForce:
    """A free-form force on one joint that the accepted effects leave over.

    share: of the gap left over that a smooth force of position, speed, command and time removes, on held-out episodes
    position, speed, command: of every held-out window (windows,); force: its estimate there, error: its standard error,
      infinite where a window shows nothing of it
    """

    joint: str
    unit: str
    share: float
    position: Array
    speed: Array
    command: Array
    force: Array
    error: Array


@dataclass(frozen=True, eq=False)
class GapReport:
    """The answer of `diagnose_gap`.

    Args:
        verdict: "effects": named effects explain the gap; "no_gap": the model, with its parameters fitted, predicts
            the recordings as well as their noise allows; "unexplained": a gap remains that no known effect explains.
        effects: Accepted causes, largest first.
        ranking: Every candidate that was refitted in the first round, in its best reading, largest shrink first.
        where: Joints by their share of the gap.
        gap: The ladder over all horizons; `horizons` the same for each, in control steps.
        distance: How far apart recorded and simulated states lie as distributions, at the longest horizon.
        base: Fitted base parameters, by name, with all accepted effects in place.
        ladder: Labels and values from the nominal model to the noise floor.
        summary: Plain words.
        held_out_episodes: Names of the episodes that no fit saw; of one cut in time, with the row from which on.
        sensor_noise: Standard deviation of the noise found on each channel, by channel.
        encoder_error: By how much joints that rest at one reading read too high, by joint [rad or m]; it was taken out
            of the recordings first.
        device: What simulated, for people.
        model: The nominal model.
    """

    verdict: Verdict
    effects: Sequence[Cause]
    ranking: Sequence[Cause]
    where: Sequence[Place]
    gap: Level
    horizons: Mapping[int, Level]
    distance: Distance
    base: Mapping[str, Fitted]
    ladder: Sequence[tuple[str, float]]
    summary: Sequence[str]
    gap_map: GapMap
    traces: Sequence[Trace]
    residual_force: ResidualForce | None
    held_out_episodes: Sequence[str]
    sensor_noise: Mapping[str, float]
    encoder_error: Mapping[str, float]
    control_dt: float
    seconds: float
    simulated_steps: int
    candidates: int
    seed: int
    device: str
    model: mujoco.MjModel = field(repr=False)

    def to_json(self) -> dict[str, Any]:
        """The contract of diagnosis.json, schema 1, as plain JSON values."""
        gap = asdict(self.gap)
        gap["distance"] = asdict(self.distance)
        gap["horizons"] = {str(h): asdict(level) for h, level in self.horizons.items()}
        force = self.residual_force
        return {
            "schema": 1,
            "verdict": self.verdict,
            "effects": [asdict(c) for c in self.effects],
            "ranking": [asdict(c) for c in self.ranking],
            "where": [asdict(p) for p in self.where],
            "gap_map": self.gap_map.to_json(),
            "gap": gap,
            "ladder": [{"label": label, "gap": value} for label, value in self.ladder],
            "parameters": {name: asdict(value) for name, value in self.base.items()},
            "summary": list(self.summary),
            "residual_force": None if force is None else {"joint": force.joint, "share": force.share},
            "sensor_noise": dict(self.sensor_noise),
            "encoder_error": dict(self.encoder_error),
            "held_out_episodes": [_number(name) for name in self.held_out_episodes],
            "candidates": self.candidates,
            "seed": self.seed,
            "device": self.device,
            "seconds": self.seconds,
            "simulated_steps": self.simulated_steps,
        }

    def save(self, folder: Path | str) -> Path:
        """Write `diagnosis.json` into a folder; returns its path."""
        path = Path(folder) / "diagnosis.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(finite(self.to_json()), indent=1) + "\n")
        return path


def _number(name: str) -> int | str:
    return int(name) if is_whole_number(name) else name
