"""What is known about how a data set was made; it travels with every file format."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from nfpde.errors import BadDataset


@dataclass(frozen=True)
class Metadata:
    """Facts about the origin of a data set, all optional.

    Attributes:
        model_hash: Hash of the model file that made or fits the recordings.
        control_dt: Control step of the recording [s]; must agree with the time column.
        timestep: Physics step of the simulator that made them [s].
        solver: MuJoCo's constraint solver ("Newton", "CG", "PGS").
        integrator: MuJoCo's integrator ("Euler", "RK4", "implicit", "implicitfast").
        versions: Software and firmware versions by name.
        conventions: Choices a reader must know ("inertia": "scaled with the mass"), by name.
        notes: Free text.
    """

    model_hash: str | None = None
    control_dt: float | None = None
    timestep: float | None = None
    solver: str | None = None
    integrator: str | None = None
    versions: Mapping[str, str] = field(default_factory=dict)
    conventions: Mapping[str, str] = field(default_factory=dict)
    notes: str = ""

    def __post_init__(self) -> None:
        for name in ("model_hash", "solver", "integrator"):
            _check(getattr(self, name) is None or isinstance(getattr(self, name), str), self, name, "text")
        for name in ("control_dt", "timestep"):
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            positive = value is None or (number and math.isfinite(value) and value > 0)
            _check(positive, self, name, "a positive number of seconds")
        for name in ("versions", "conventions"):
            value = getattr(self, name)
            texts = isinstance(value, Mapping) and all(isinstance(text, str) for pair in value.items() for text in pair)
            _check(texts, self, name, "a mapping from text to text")
            object.__setattr__(self, name, dict(value))
        _check(isinstance(self.notes, str), self, "notes", "text")

    def to_json(self) -> str:
        """The metadata as a JSON object, keys in the order of the fields."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Metadata":
        """Read what `to_json` wrote.

        Args:
            text: A JSON object; missing fields take their default.

        Returns:
            The metadata.

        Raises:
            BadDataset: The text is no JSON object, or has a field that metadata does not have.
        """
        try:
            values: Any = json.loads(text)
        except ValueError as error:
            raise BadDataset(f"the metadata is no JSON ({error}); it must be a JSON object.") from None
        if not isinstance(values, dict):
            raise BadDataset(f"the metadata is a JSON {type(values).__name__}; it must be a JSON object.")
        known = [f.name for f in fields(cls)]
        unknown = [name for name in values if name not in known]
        if unknown:
            raise BadDataset(
                f"the metadata has unknown field(s) {', '.join(unknown)}; known are {', '.join(known)}. "
                "Put anything else under conventions or notes."
            )
        return cls(**values)


def _check(good: bool, metadata: Metadata, name: str, rule: str) -> None:
    if not good:
        raise BadDataset(f"the metadata's {name} is {getattr(metadata, name)!r}; it must be {rule}.")
