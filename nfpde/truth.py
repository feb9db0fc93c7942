"""`Truth`: the parameters that robots really had, known only where the recordings were simulated."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.errors import BadInput, NfpdeError, SpaceMismatch
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.storage import read_json, write_whole

_Array = NDArray[np.float64]

SCHEMA_VERSION = 1


@dataclass(frozen=True, eq=False)
class Population:
    """A mixture of Gaussians cut to the box of a space: what the robots' parameters were drawn from.

    Args:
        weights: (K,), non-negative, with sum 1.
        means: (K, D), in physical units.
        covariances: (K, D, D), symmetric and positive semidefinite, in products of physical units.

    Raises:
        BadInput: One of these rules is broken.
    """

    weights: NDArray[np.float64]
    means: NDArray[np.float64]
    covariances: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("weights", "means", "covariances"):
            object.__setattr__(self, name, _array(f"population.{name}", getattr(self, name)))
        k, d = self.means.shape if self.means.ndim == 2 else (0, 0)
        if not k or not d or self.weights.shape != (k,) or self.covariances.shape != (k, d, d):
            raise BadInput(
                "a population needs weights (K,), means (K, D) and covariances (K, D, D), got "
                f"{self.weights.shape}, {self.means.shape} and {self.covariances.shape}"
            )
        if (self.weights < 0).any() or abs(self.weights.sum() - 1) > 1e-9:
            raise BadInput(f"population.weights must be non-negative with sum 1, got {self.weights.tolist()}")
        for i, c in enumerate(self.covariances):
            size = np.abs(c).max()
            if np.abs(c - c.T).max() > 1e-9 * size or np.linalg.eigvalsh(c)[0] < -1e-9 * size:
                raise BadInput(f"population.covariances[{i}] is not symmetric and positive semidefinite")

    def sample(self, n: int, space: ParameterSpace, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw n vectors (n, D) from the mixture, throwing away what falls outside the box.

        Raises:
            BadInput: Less than about one draw in a thousand falls inside the box.
        """
        values, vectors = np.linalg.eigh(self.covariances)
        factors = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        kept, have, drawn = [], 0, 0
        while have < n:
            if drawn > 1000 * (have + 10):
                raise BadInput(f"only {have} of {drawn} draws of the population fall inside the box of {space}")
            count = max(n - have, 100)
            k = rng.choice(len(self.weights), size=count, p=self.weights)
            noise = rng.standard_normal((count, len(space)))
            xi = self.means[k] + np.einsum("nij,nj->ni", factors[k], noise)
            xi = xi[((xi >= space.low) & (xi <= space.high)).all(1)]
            kept.append(xi)
            have, drawn = have + len(xi), drawn + count
        return np.concatenate(kept)[:n] if kept else np.empty((0, len(space)))


@dataclass(frozen=True, eq=False)
class Truth:
    """True parameters of the recorded episodes.

    Args:
        space: The parameters.
        xi: (E, D), in physical units, inside the box.
        episodes: E names of episodes, as in the data set.
        population: What `xi` was drawn from; None where that is not known.
        dataset: `Dataset.content_hash` of the recordings that it is the truth of; None where that is not known.

    Raises:
        BadInput: Shapes or names that do not fit, or a value outside the box.
    """

    space: ParameterSpace
    xi: NDArray[np.float64]
    episodes: Sequence[str]
    population: Population | None = None
    dataset: str | None = None

    def __post_init__(self) -> None:
        given = _array("xi", self.xi)
        try:
            xi = _array("xi", self.space.check(given))
        except NfpdeError as error:
            raise BadInput(f"true parameters: {error}") from None
        object.__setattr__(self, "xi", xi)
        names = self.episodes
        if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(e, str) for e in names):
            raise BadInput(f"episodes must be a list of texts, the episodes' names; got {_short(names)}")
        object.__setattr__(self, "episodes", tuple(names))
        if len(self.episodes) != len(xi) or not len(xi):
            raise BadInput(
                f"there are {len(xi)} true parameter vectors and {len(self.episodes)} episode names; give one of each "
                "for every episode"
            )
        if len(set(self.episodes)) != len(self.episodes):
            raise BadInput(f"episode names must be unique, got {list(self.episodes)}")
        if self.population is not None and self.population.means.shape[1] != len(self.space):
            raise BadInput(
                f"the population has {self.population.means.shape[1]} parameters, the space {len(self.space)}"
            )

        if self.dataset is not None and (not isinstance(self.dataset, str) or not self.dataset):
            raise BadInput(f"dataset must be a text, the content hash of the recordings; got {self.dataset!r}")

    @property
    def robots(self) -> NDArray[np.float64]:
        """The different ones of the episodes' vectors, in order of appearance: a row for each robot, (G, D)."""
        return self.xi[np.sort(np.unique(self.xi, axis=0, return_index=True)[1])]

    def over(self, space: ParameterSpace) -> Truth:
        """The same of a space with the same parameters, in its order and with its bounds, without the population.

        A fit may have searched in other bounds than those in which the robots were drawn; the population is cut to the
        bounds that it was drawn in, and stays with them (`draw_population`).

        Raises:
            SpaceMismatch: The spaces are about different parameters; names those that one of them lacks.
            BadInput: True parameters lie outside of the other bounds.
        """
        if space == self.space:
            return self
        return Truth(space, self.xi[:, self.columns_in(space)], self.episodes, None, self.dataset)

    def draw_population(self, n: int, rng: np.random.Generator, space: ParameterSpace | None = None) -> _Array | None:
        """Draws of the population (n, D), in the order of a space with the same parameters; None where it is not known.

        Raises:
            SpaceMismatch: The space is about different parameters.
        """
        if self.population is None:
            return None
        drawn = self.population.sample(n, self.space, rng)
        return drawn if space is None else drawn[:, self.columns_in(space)]

    def columns_in(self, space: ParameterSpace) -> list[int]:
        """Where each parameter of a space with the same parameters stands here, whatever their bounds.

        Whether the inertia goes along with a mass makes it no other parameter.

        Raises:
            SpaceMismatch: The spaces are about different parameters; names those that one of them lacks.
        """
        own, other = ([_about(p) for p in s] for s in (self.space, space))
        if len(set(own)) < len(own):  # own simulators may tell parameters apart by name alone
            own, other = ([_about(p, p.name) for p in s] for s in (self.space, space))
        if len(own) != len(other) or set(own) != set(other):
            lacks = [p.name for p, key in zip(self.space, own, strict=True) if key not in other]
            more = [p.name for p, key in zip(space, other, strict=True) if key not in own]
            raise SpaceMismatch(
                "the true parameters and the other ones are not the same, apart from their bounds; only the truth has "
                f"{', '.join(lacks) or 'none'}, only the others {', '.join(more) or 'none'} (field, target, component "
                "and relative count)"
            )
        return [own.index(key) for key in other]

    def save(self, path: Path | str) -> None:
        """Write everything as one JSON file."""
        content: dict[str, Any] = {
            "schema_version": SCHEMA_VERSION,
            "space": self.space.to_json(),
            "episodes": list(self.episodes),
            "xi": self.xi.tolist(),
        }
        if self.dataset is not None:
            content["dataset"] = self.dataset
        if self.population is not None:
            names = ("weights", "means", "covariances")
            content["population"] = {name: getattr(self.population, name).tolist() for name in names}
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(content, indent=1, ensure_ascii=False))

    @classmethod
    def load(cls, path: Path | str) -> Truth:
        """Read what `save` wrote, the same to the last bit.

        Raises:
            BadInput: The file is missing, not JSON, of another schema, or breaks a rule of `Truth`.
        """
        path = Path(path)
        content = read_json(path, SCHEMA_VERSION)
        try:
            space = ParameterSpace.from_json(content["space"], "space")
            population = _population(content.get("population"))
            return cls(space, content["xi"], content["episodes"], population, content.get("dataset"))
        except KeyError as error:
            raise BadInput(f"{path}: the entry {error} is missing") from None
        except NfpdeError as error:
            raise BadInput(f"{path}: {error}") from None


def _about(p: Parameter, name: str = "") -> tuple[object, ...]:
    """What a parameter is, whatever its bounds, and its name if it is not given."""
    target = p.target[0] if isinstance(p.target, tuple) and len(p.target) == 1 else p.target
    return p.field, target, p.component, p.relative, name


def _population(entry: object) -> Population | None:
    """What a file says about the population."""
    if entry is None:
        return None
    names = list(Population.__dataclass_fields__)
    if not isinstance(entry, dict) or set(entry) != set(names):
        found = ", ".join(entry) or "nothing" if isinstance(entry, dict) else _short(entry)
        raise BadInput(f"population must be an object with the entries {', '.join(names)}; found: {found}")
    return Population(**entry)


def _array(name: str, values: object) -> NDArray[np.float64]:
    try:
        array = np.array(values)
    except ValueError:
        raise BadInput(f"{name} must be numbers in lists of equal length") from None
    if array.dtype.kind not in "iuf":
        raise BadInput(f"{name} must hold numbers and nothing else, got {_short(values)}")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise BadInput(f"{name} holds a number that is not finite")
    array.flags.writeable = False
    return array


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
