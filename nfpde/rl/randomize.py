"""A Gymnasium environment whose physical parameters are drawn anew at every reset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import gymnasium
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.errors import BadInput, BadParameter, SimulationDiverged
from nfpde.live import LivePhysics, PhysicsDiverged
from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]

BLOCK = 256
"""Vectors drawn at once: one call of a flow costs about as much for one as for hundreds."""


@runtime_checkable
class Draws(Protocol):
    """What parameters are drawn from; `nfpde.ParameterDistribution` is one."""

    @property
    def space(self) -> ParameterSpace:
        """The parameters."""
        ...

    def sample(self, n: int, seed: int = 0) -> Array:
        """Draw n vectors, (n, D)."""
        ...


class RandomizedParameters(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Draws a parameter vector at every reset and writes it, effects included, into the environment's live model.

    The draw of a seeded reset, and of all resets after it, depends on the seed alone, through a random stream of
    its own: the environment's start states do not depend on it. `reset` returns the parameters as
    `info["parameters"]`, name to value in the parameters' units, and so does the last step of an episode; the
    vector itself is `.parameters`. `reset(options={"parameters": vector})` sets the vector of one episode.

    A simulation that diverges (MuJoCo would start it afresh and go on) ends the episode as truncated, with
    `info["diverged"]` True, reward 0 and the last good observation; `.diverged_episodes` counts them.

    Args:
        env: a MuJoCo environment of Gymnasium, in any wrappers.
        source: a distribution; or one vector (D,), the same for every episode; or samples (n, D), one of which is
            drawn for each episode; or None for the model as it is.
        space: what the numbers of a vector mean; needed unless `source` is a distribution, which has its own.

    Raises:
        BadInput: no MuJoCo environment, one that is wrapped already, or a missing space.
        BadParameter, BadEffect: vectors outside the space, elements the model lacks, effects that cannot act.

    Example:
        >>> from nfpde.parameters import Parameter
        >>> space = ParameterSpace([Parameter("body_mass", "thigh", 2.0, 6.0)])
        >>> env = RandomizedParameters(gymnasium.make("Hopper-v5"), [[3.0], [5.0]], space)
        >>> env.reset(seed=0)[1]["parameters"]["body_mass:thigh"] in (3.0, 5.0)
        True
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        source: Draws | ArrayLike | None,
        space: ParameterSpace | None = None,
    ) -> None:
        super().__init__(env)
        self.source, self.space = check_source(source, space)
        self._physics = LivePhysics(env.unwrapped, self.space)
        self._rng = np.random.default_rng()
        self._block = np.empty((0, len(self.space)))
        self._observation: Any = None
        self.parameters: Array | None = None
        self.diverged_episodes = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Draw parameters, write them into the model and start an episode.

        Raises:
            SimulationDiverged: the environment simulates in its reset, and that blew up; names the parameters.
        """
        options = dict(options or {})
        if seed is not None:
            # a child of the seed's sequence, so that draws are independent of the environment's own randomness
            self._rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0])
            self._block = self._block[:0]
        given = options.pop("parameters", None)
        xi = self._draw() if given is None else self._given(given)
        self.parameters = xi
        self._physics.write(xi)
        try:
            observation, info = self.env.reset(seed=seed, options=options or None)
        except PhysicsDiverged:
            raise SimulationDiverged(
                f"environment {self.label}: the simulation diverged within reset() of an episode with "
                f"{self._named() or 'nominal parameters'}: use a smaller timestep in the model, or tighter bounds"
            ) from None
        self._physics.start()
        self._observation = observation
        return observation, {**info, "parameters": self._named()}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Advance by one control step.

        Raises:
            BadInput, BadEffect: the environment's step goes past the simulation, or past the sensors, that are put in.
        """
        try:
            observation, reward, terminated, truncated, info = self.env.step(action)
        except PhysicsDiverged:
            self.diverged_episodes += 1
            return self._observation, 0.0, False, True, {"diverged": True, "parameters": self._named()}
        self._observation = observation
        if terminated or truncated:
            info = {**info, "parameters": self._named()}
        return observation, reward, terminated, truncated, info

    @property
    def label(self) -> str:
        """Gymnasium id of the environment, or its class."""
        return self._physics.label

    @property
    def nominal_model(self) -> mujoco.MjModel:
        """The environment's model before any parameter was written, as `nfpde.sim.load_model` prepares it."""
        return self._physics.nominal_model

    @property
    def pending_commands(self) -> int:
        """Commands that may be under way, or still act, when the next one is given: under delays and lags."""
        return self._physics.pending_commands

    def release(self) -> None:
        """Leave the wrapped environment as it was before: its own physics and solver, nominal parameters."""
        self._physics.release()

    def _draw(self) -> Array | None:
        if self.source is None:
            return None
        if isinstance(self.source, np.ndarray):
            return self.source[int(self._rng.integers(len(self.source)))]
        if not len(self._block):
            drawn = self.source.sample(BLOCK, seed=int(self._rng.integers(2**31)))
            self._block = self.space.check(np.asarray(drawn, dtype=np.float64))
        xi, self._block = self._block[0], self._block[1:]
        return xi

    def _given(self, value: Any) -> Array:
        if isinstance(value, Mapping):
            if set(value) != set(self.space.names):
                raise BadParameter(
                    f"reset options: parameters must name exactly {', '.join(self.space.names)}; got "
                    f"{', '.join(map(str, value))}"
                )
            value = [value[n] for n in self.space.names]
        return fixed_vectors(value, self.space, "reset options: parameters", one=True)[0]

    def _named(self) -> dict[str, float]:
        if self.parameters is None:
            return {}
        return dict(zip(self.space.names, self.parameters.tolist(), strict=True))


def check_source(source: Draws | ArrayLike | None, space: ParameterSpace | None) -> tuple[Any, ParameterSpace]:
    """The source as a distribution, an array (n, D) or None, and its space.

    Raises:
        BadInput: neither a distribution nor a space, or a space that is none.
        BadParameter: vectors that do not fit the space.
        SpaceMismatch: a distribution over another space than the one given.
    """
    if space is not None:
        check_space(space)
    if isinstance(source, Draws):
        if space is not None:
            source.space.check_same(space)
        return source, source.space
    if space is None:
        what = "None" if source is None else f"a {type(source).__name__}"
        raise BadInput(
            f"parameters come from a distribution (an object with .space and .sample), or from numbers with space=; "
            f"got {what} without a space"
        )
    return (None if source is None else fixed_vectors(source, space, "parameters")), space


def check_space(space: ParameterSpace) -> None:
    """Refuse what is no space, a list of parameters above all.

    Raises:
        BadInput: names its type.
    """
    if not isinstance(space, ParameterSpace):
        raise BadInput(
            f"space is a {type(space).__name__}; give a ParameterSpace, which ParameterSpace([Parameter(...), ...]) "
            "makes of a list"
        )


def fixed_vectors(value: ArrayLike, space: ParameterSpace, where: str, *, one: bool = False) -> Array:
    """Parameter vectors as (n, D), checked against the space; `where` opens the message of an error.

    Raises:
        BadParameter: no numbers, another shape, or values outside their bounds.
    """
    try:
        xi = space.check(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise BadParameter(f"{where}: not numbers: {error}") from None
    except BadParameter as error:
        raise BadParameter(f"{where}: {error}") from None
    if len(xi) == 0 or (one and len(xi) != 1):
        raise BadParameter(f"{where}: expected {'one vector' if one else 'at least one vector'}, got {len(xi)}")
    return xi
