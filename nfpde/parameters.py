"""The unknowns: one `Parameter` each, a `ParameterSpace` for all, and the map between the box and R^D.

The physical parameters are called xi, shape (n, D), in the units of the model; their unconstrained twins z, same
shape, live in R^D. The map is the sigmoid box of Takano et al., IROS 2024, Eq. 12.
"""

from __future__ import annotations

import json
import math
import sys
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit, log_expit, logit

from nfpde.errors import BadParameter, SpaceMismatch
from nfpde.storage import write_whole

Target = str | int | tuple[str | int, ...] | None

UNITS = {
    "body_mass": "kg",
    "body_inertia": "kg m²",
    "body_ipos": "m",
    "body_pos": "m",
    "dof_damping": "Nm s/rad",
    "dof_frictionloss": "Nm",
    "dof_armature": "kg m²",
    "jnt_stiffness": "Nm/rad",
    "qpos_spring": "rad",
    "opt.gravity": "m/s²",
    "opt.density": "kg/m³",
    "opt.viscosity": "Pa s",
    "opt.wind": "m/s",
}
"""Unit of the mjModel fields that have one; for slide joints read N for Nm and m for rad."""


@dataclass(frozen=True)
class Parameter:
    """One unknown of the simulation, with hard bounds.

    Args:
        field: an mjModel field (`body_mass`, `dof_damping`, `geom_friction`, `actuator_gainprm`, ...), an mjOption
            field (`opt.gravity`), a parameter of an effect (`coulomb_friction.torque`), or any name that your own
            simulator knows.
        target: name or id of the element, a tuple of them (all get the same value), or "*" for all elements of
            the field's kind; None where the field belongs to no element.
        low: lower bound, in the field's unit. Masses, inertias, damping and friction cannot be negative. Keep
            `geom_friction` above 1e-5: MuJoCo and MuJoCo Warp take less for 1e-5, so that values below are all alike.
        high: upper bound, greater than `low`.
        component: which number of a field that has several per element (0 is the sliding coefficient of
            `geom_friction`, the gain of `actuator_gainprm`).
        relative: the value multiplies the model's own instead of replacing it.
        scale_inertia: for `body_mass`, scale `body_inertia` by the same ratio (the body's density changes);
            False changes the mass alone.
        unit: shown in tables and plots; by default the field's.
        name: shown in tables and plots, unique in a space; by default `field:target`.

    Raises:
        BadParameter: bounds that are not finite and increasing or whose width float64 cannot hold, an empty field or
            target, or a value of the wrong type.

    Example:
        >>> Parameter("body_mass", "thigh", 2.0, 6.0).name
        'body_mass:thigh'
    """

    field: str
    target: Target = None
    low: float = -math.inf
    high: float = math.inf
    component: int = 0
    relative: bool = False
    scale_inertia: bool = True
    unit: str = ""
    name: str = ""

    def __post_init__(self) -> None:
        shown = self._check_target()
        for key in ("field", "unit", "name"):
            if not isinstance(getattr(self, key), str):
                raise BadParameter(f"parameter {shown}: {key} must be a text, got {getattr(self, key)!r}")
        if not self.name:
            suffix = f"[{self.component}]" if self.component else ""
            object.__setattr__(self, "name", shown + suffix)
        if not self.unit and not self.relative:
            object.__setattr__(self, "unit", UNITS.get(self.field, ""))
        if not self.field or self.target in ((), ""):
            raise BadParameter(f"parameter {self.name!r}: field and target may not be empty")
        for key in ("relative", "scale_inertia"):
            if not isinstance(getattr(self, key), bool):
                raise BadParameter(f"parameter {self.name!r}: {key} must be true or false, got {getattr(self, key)!r}")
        component: Any = self.component
        if isinstance(component, bool) or not isinstance(component, int | np.integer) or component < 0:
            raise BadParameter(f"parameter {self.name!r}: component must be an integer >= 0, got {component!r}")
        object.__setattr__(self, "component", int(component))
        self._check_bounds()

    def _check_target(self) -> str:
        """Turn a list of targets into a tuple, check their types, and return the parameter's name by default."""
        given = self.target
        single = [
            int(t) if isinstance(t, np.integer) else t for t in (given if isinstance(given, list | tuple) else [given])
        ]
        target = tuple(single) if isinstance(given, list | tuple) else single[0]
        object.__setattr__(self, "target", target)
        if target is not None and any(isinstance(t, bool) or not isinstance(t, str | int) for t in single):
            raise BadParameter(
                f"parameter {self.field}: target must be a name, an id (an integer) or a list of them, got {target!r}"
            )
        return f"{self.field}" if target is None else f"{self.field}:{'+'.join(str(t) for t in single)}"

    def _check_bounds(self) -> None:
        for which in ("low", "high"):
            value = getattr(self, which)
            if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
                raise BadParameter(f"parameter {self.name!r}: {which} must be a number, got {value!r}")
            if abs(value) > sys.float_info.max or value != value:
                shown = f"{value}" if isinstance(value, float | np.floating) else "an integer beyond float64"
                raise BadParameter(
                    f"parameter {self.name!r}: {which} is {shown}; both bounds must be given and finite: they are the "
                    "prior knowledge the fit starts from"
                )
            object.__setattr__(self, which, float(value))
        if not self.low < self.high:
            raise BadParameter(
                f"parameter {self.name!r}: low ({self.low:g}) must be below high ({self.high:g}); to fix a value, set "
                "it in the model and leave the parameter out"
            )
        if not sys.float_info.min <= self.high - self.low <= sys.float_info.max:
            raise BadParameter(
                f"parameter {self.name!r}: high - low is {self.high - self.low:g} for the bounds {self.low:g} and "
                f"{self.high:g}; it must lie between {sys.float_info.min:.2g} and {sys.float_info.max:.2g}, the range "
                "of float64: use another unit"
            )


class ParameterSpace:
    """An ordered box of parameters.

    Args:
        parameters: at least one, with unique names.

    Raises:
        BadParameter: no parameter, something that is no `Parameter`, or a name used twice.

    Example:
        >>> space = ParameterSpace([Parameter("body_mass", "thigh", 2.0, 6.0)])
        >>> space.to_physical(space.to_unconstrained([[3.0]]))
        array([[3.]])
    """

    def __init__(self, parameters: Iterable[Parameter]) -> None:
        given: Any = parameters
        if isinstance(given, Parameter):
            raise BadParameter(
                f"a ParameterSpace is made of a list, got the Parameter {given.name!r} alone: put it in []"
            )
        if isinstance(given, str) or not isinstance(given, Iterable):
            raise BadParameter(f"a ParameterSpace is made of a list of Parameter objects, got {given!r}")
        self.parameters = tuple(parameters)
        for p in self.parameters:
            if not isinstance(p, Parameter):
                raise BadParameter(f"a ParameterSpace is made of Parameter objects, got {type(p).__name__}: {p!r}")
        if not self.parameters:
            raise BadParameter("a ParameterSpace needs at least one Parameter; there is nothing to estimate")
        self.names = [p.name for p in self.parameters]
        twice = sorted({n for n in self.names if self.names.count(n) > 1})
        if twice:
            raise BadParameter(f"parameter names must be unique; used more than once: {', '.join(twice)}")
        self.units = [p.unit for p in self.parameters]
        self.low = np.array([p.low for p in self.parameters])
        self.high = np.array([p.high for p in self.parameters])
        self.width = self.high - self.low
        for bound in (self.low, self.high, self.width):
            bound.flags.writeable = False

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __getitem__(self, index: int) -> Parameter:
        return self.parameters[index]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ParameterSpace) and self.parameters == other.parameters

    def __hash__(self) -> int:
        return hash(self.parameters)

    def __repr__(self) -> str:
        return f"ParameterSpace({len(self)} parameters: {', '.join(self.names)})"

    def __add__(self, other: Iterable[Parameter]) -> ParameterSpace:
        return ParameterSpace([*self, *other])

    def to_physical(self, z: ArrayLike) -> NDArray[np.float64]:
        """Box of Eq. 12: xi = low + (high - low) * sigmoid(z), shape (..., D) to (..., D)."""
        z = np.asarray(z, dtype=np.float64)
        # from the nearer end, so that values close to `high` keep their distance from it
        return np.where(z < 0, self.low + self.width * expit(z), self.high - self.width * expit(-z))

    def to_unconstrained(self, xi: ArrayLike) -> NDArray[np.float64]:
        """Inverse of `to_physical`, (..., D) to (..., D); a value on a bound gives -inf or inf."""
        xi = np.asarray(xi, dtype=np.float64)
        unit = (xi - self.low) / self.width
        other = (self.high - xi) / self.width
        return np.where(unit < 0.5, logit(np.clip(unit, 0, 1)), -logit(np.clip(other, 0, 1)))

    def log_det_jacobian(self, z: ArrayLike) -> NDArray[np.float64]:
        """Log |d xi / d z|, summed over the parameters: (..., D) to (...)."""
        z = np.asarray(z, dtype=np.float64)
        return (np.log(self.width) + log_expit(z) + log_expit(-z)).sum(-1)

    def check(self, xi: ArrayLike) -> NDArray[np.float64]:
        """Return parameter vectors as a float64 array (n, D).

        Raises:
            BadParameter: no numbers, wrong shape, a value that is not finite, or one outside its bounds.
        """
        try:
            xi = np.atleast_2d(np.asarray(xi, dtype=np.float64))
        except (TypeError, ValueError):
            raise BadParameter(
                f"parameter vectors must be numbers in rows of one length, shape (n, {len(self)}), got {xi!r}: {self}"
            ) from None
        if xi.ndim != 2 or xi.shape[1] != len(self):
            raise BadParameter(f"parameter vectors must have shape (n, {len(self)}), got {xi.shape}: {self}")
        bad = ~((xi >= self.low) & (xi <= self.high))
        if bad.any():
            row, column = np.argwhere(bad)[0]
            p = self.parameters[column]
            raise BadParameter(
                f"row {row}: {p.name} = {xi[row, column]:g} lies outside [{p.low:g}, {p.high:g}]"
                f" ({int(bad.any(1).sum())} of {len(xi)} rows leave the box)"
            )
        return xi

    def uniform(self, n: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw n vectors uniformly from the box, (n, D)."""
        return self.low + self.width * rng.random((n, len(self)))

    def check_same(self, other: ParameterSpace) -> None:
        """Raise SpaceMismatch, naming the first difference, unless both spaces are equal."""
        if len(self) != len(other):
            raise SpaceMismatch(
                f"{len(self)} parameters against {len(other)}: {', '.join(self.names)} | {', '.join(other.names)}"
            )
        for i, (mine, theirs) in enumerate(zip(self, other, strict=True)):
            for key, value in asdict(mine).items():
                if value != getattr(theirs, key):
                    raise SpaceMismatch(
                        f"parameter {i} ({mine.name}): {key} is {value!r} here and {getattr(theirs, key)!r} there"
                    )

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values; `from_json` reads them back."""
        return {"parameters": [asdict(p) for p in self]}

    @classmethod
    def from_json(cls, value: dict[str, Any], source: str = "parameter space") -> ParameterSpace:
        """Read what `to_json` wrote; `source` names it in errors.

        Raises:
            BadParameter: anything but a list of parameter tables.
        """
        tables = value.get("parameters") if isinstance(value, dict) else None
        if not isinstance(tables, list):
            raise BadParameter(f"{source}: expected an object with a list 'parameters'")
        return cls([_from_table(t, f"{source}, parameter {i}") for i, t in enumerate(tables)])

    @classmethod
    def from_toml(cls, path: str | Path) -> ParameterSpace:
        """Read `[[parameter]]` tables: field, target, low, high and the other arguments of `Parameter`.

        Raises:
            BadParameter: no such file, broken TOML, or a table that breaks a rule (named by its number).
        """
        path = Path(path)
        try:
            content = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise BadParameter(f"{path}: cannot be read ({error.strerror})") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise BadParameter(f"{path}: not valid TOML: {error}") from None
        tables = content.get("parameter")
        if not isinstance(tables, list) or set(content) != {"parameter"}:
            raise BadParameter(
                f"{path}: expected [[parameter]] tables and nothing else, found: {sorted(content) or 'nothing'}"
            )
        return cls([_from_table(t, f"{path}, parameter {i}") for i, t in enumerate(tables)])

    def to_toml(self, path: str | Path) -> None:
        """Write the `[[parameter]]` tables that `from_toml` reads."""
        default = Parameter("x", low=0, high=1)
        lines: list[str] = []
        for p in self:
            lines.append("[[parameter]]")
            plain = Parameter(p.field, p.target, p.low, p.high, p.component, p.relative, p.scale_inertia)
            for key, value in asdict(p).items():
                automatic = plain if key in ("name", "unit") else default
                if key in ("field", "low", "high") or value != getattr(automatic, key):
                    lines.append(f"{key} = {_toml(value)}")
            lines.append("")
        write_whole(Path(path), "\n".join(lines))


def _from_table(table: object, where: str) -> Parameter:
    if not isinstance(table, dict):
        raise BadParameter(f"{where}: expected a table, got {table!r}")
    known = set(Parameter.__dataclass_fields__)
    unknown = sorted(set(table) - known)
    if unknown:
        raise BadParameter(f"{where}: unknown key {unknown[0]!r}; known: {', '.join(sorted(known))}")
    missing = [key for key in ("field", "low", "high") if key not in table]
    if missing:
        raise BadParameter(f"{where}: {', '.join(missing)} missing")
    try:
        return Parameter(**table)
    except BadParameter as error:
        raise BadParameter(f"{where}: {error}") from None


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Sequence):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return repr(value)
