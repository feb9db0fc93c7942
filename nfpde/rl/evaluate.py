"""How well a policy does: mean return over episodes on given or drawn parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.errors import BadInput, SimulationDiverged
from nfpde.parameters import ParameterSpace
from nfpde.rl.randomize import Draws, RandomizedParameters, check_source
from nfpde.rl.tasks import Environment, make_environment

Array = NDArray[np.float64]

ENDLESS = 100_000
"""Control steps after which an episode counts as one that never ends."""


class Predicts(Protocol):
    """A policy: `Policy`, or an agent of Stable-Baselines3."""

    def predict(self, observation: Any) -> Any:
        """Action for one observation, or a tuple that starts with it."""
        ...


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Returns of E episodes.

    returns: sum of rewards of each episode                                        (E,)
    lengths: control steps of each episode                                         (E,)
    parameters: vectors the episodes ran with, None for the nominal model          (E, D)
    """

    returns: Array
    lengths: NDArray[np.int64]
    parameters: Array | None

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(self.returns.mean())

    @property
    def standard_error(self) -> float:
        """Standard error of the mean return, over episodes."""
        return float(self.returns.std(ddof=1) / np.sqrt(len(self.returns)))

    def __repr__(self) -> str:
        return f"Evaluation({self.mean:.4g} ± {self.standard_error:.2g} over {len(self.returns)} episodes)"


def evaluate_policy(
    policy: Predicts | Callable[[Any], Any],
    env: Environment | RandomizedParameters,
    source: Draws | ArrayLike | None = None,
    *,
    space: ParameterSpace | None = None,
    episodes: int = 20,
    seed: int = 0,
) -> Evaluation:
    """Run episodes with a policy and add up their rewards.

    Equal seeds give equal parameters and start states, so that two policies are compared on the same episodes.

    Args:
        policy: has `predict(observation)`, or is a function from observation to action.
        env: name or maker of a MuJoCo environment, see `make_environment`; or one wrapped in `RandomizedParameters`,
            whose source then counts where `source` is None.
        source: parameters of the episodes: a distribution to draw from; or fixed vectors (n, D), the "real" robots,
            taken in turn; None for the nominal model.
        space: what fixed vectors mean; in an environment under `RandomizedParameters` they are of its space.
        episodes: how many, at least 2.
        seed: of draws and start states.

    Raises:
        BadInput: fewer than 2 episodes, a negative seed, an environment or source that cannot be used, or episodes
            without an end.
        SpaceMismatch: a space, or a distribution over one, that is not the wrapped environment's.
        SimulationDiverged: an episode blew up, so that it has no return; names its parameters.
    """
    if isinstance(episodes, bool) or not isinstance(episodes, int) or episodes < 2:
        raise BadInput(f"episodes is {episodes!r}; it must be a whole number, at least 2 (for a standard error)")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise BadInput(f"seed is {seed!r}; it must be a whole number, at least 0")
    seed = int(seed)
    made = None
    if isinstance(env, RandomizedParameters):
        if space is not None:
            space.check_same(env.space)
        wrapped, given = env, env.source if source is None else check_source(source, env.space)[0]
    else:
        if source is None and space is None:
            raise BadInput("give the parameters' space for an evaluation on the nominal model")
        made = wrapped = RandomizedParameters(make_environment(env), source, space)
        given = made.source
    vectors = _vectors(given, wrapped.space, episodes, seed)
    act = _actor(policy)
    seeds = np.random.SeedSequence(seed).generate_state(episodes)
    returns, lengths = np.zeros(episodes), np.zeros(episodes, np.int64)
    try:
        for i in range(episodes):
            options = None if vectors is None else {"parameters": vectors[i]}
            returns[i], lengths[i] = _episode(act, wrapped, int(seeds[i]), options)
    finally:
        if made is not None:
            made.close()
    return Evaluation(returns, lengths, vectors)


def _episode(
    act: Callable[[Any], Any], env: RandomizedParameters, seed: int, options: dict[str, Any] | None
) -> tuple[float, int]:
    observation, info = env.reset(seed=seed, options=options)
    total, length, over = 0.0, 0, False
    while not over:
        if length == ENDLESS:
            raise BadInput(
                f"environment {env.label}: an episode did not end within {ENDLESS} control steps; give it an end, for "
                "example gymnasium.wrappers.TimeLimit(env, max_episode_steps=1000)"
            )
        observation, reward, terminated, truncated, step_info = env.step(act(observation))
        if step_info.get("diverged"):
            raise SimulationDiverged(
                f"the simulation diverged after {length} control steps of an episode with {info['parameters']}: use a "
                "smaller timestep in the model, or tighter bounds"
            )
        total, length, over = total + float(reward), length + 1, bool(terminated or truncated)
    return total, length


def _vectors(source: Any, space: ParameterSpace, episodes: int, seed: int) -> Array | None:
    if source is None:
        return None
    if isinstance(source, Draws):
        return space.check(np.asarray(source.sample(episodes, seed=seed), dtype=np.float64))
    array = space.check(source)
    return array[np.arange(episodes) % len(array)]


def _actor(policy: Predicts | Callable[[Any], Any]) -> Callable[[Any], Any]:
    predict: Any = getattr(policy, "predict", policy)

    def act(observation: Any) -> Any:
        action = predict(observation)
        return action[0] if isinstance(action, tuple) else action

    return act
