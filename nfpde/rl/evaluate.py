"""How well a policy does: mean return over episodes on given or drawn parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.errors import BadInput, SimulationDiverged
from nfpde.parameters import ParameterSpace
from nfpde.rl.actor import Actor, BadAction, NotFinite, Predicts
from nfpde.rl.behaviour import Repetition
from nfpde.rl.numbers import seed_number, whole_number
from nfpde.rl.past import Controller, past_commands_of
from nfpde.rl.policy import Policy
from nfpde.rl.randomize import Draws, RandomizedParameters, check_source, check_space
from nfpde.rl.tasks import Environment, make_environment

Array = NDArray[np.float64]

ENDLESS = 100_000
"""Control steps after which an episode counts as one that never ends."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Returns of E episodes.

    returns: sum of rewards of each episode                                        (E,)
    lengths: control steps of each episode                                         (E,)
    parameters: vectors the episodes ran with, None for the nominal model          (E, D)
    given: number of fixed vectors they were chosen from, None for a distribution or the nominal model
    """

    returns: Array
    lengths: NDArray[np.int64]
    parameters: Array | None
    given: int | None = None

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(self.returns.mean())

    @property
    def standard_error(self) -> float:
        """Standard error of the mean return, over episodes."""
        return float(self.returns.std(ddof=1) / np.sqrt(len(self.returns)))

    def __repr__(self) -> str:
        count = len(self.returns)
        chosen = "" if self.given is None or self.given <= count else f", {count} of {self.given} parameter vectors"
        return f"Evaluation({self.mean:.4g} ± {self.standard_error:.2g} over {count} episodes{chosen})"


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

    Equal seeds give equal parameters and start states, so that two policies are compared on the same episodes. An
    environment that carries something over from one episode to the next, running statistics for example, is refused:
    two short test episodes before and after the others must come out the same.

    Args:
        policy: has `predict(observation)`, or is a function from observation to action. Agents of Stable-Baselines3
            act without exploration, recurrent ones with their state; a `Policy` remembers its past commands where
            the environment's observations do not hold them.
        env: name or maker of a MuJoCo environment, see `make_environment`; or one wrapped in `RandomizedParameters`,
            whose source then counts where `source` is None.
        source: parameters of the episodes: a distribution to draw from; or fixed vectors (n, D), the "real" robots,
            taken in turn; of more vectors than episodes as many, drawn by the seed from equal stretches of the
            array, one of each; None for the nominal model.
        space: what fixed vectors mean; in an environment under `RandomizedParameters` they are of its space.
        episodes: how many, at least 2.
        seed: of draws and start states, from 0 to 2**63 - 1.

    Raises:
        BadInput: fewer than 2 episodes, a seed outside of its range, an environment or source that cannot be used,
            episodes without an end, or an environment that carries something over between episodes; a policy for
            other observations or actions, or one whose actions are not finite.
        SpaceMismatch: a space, or a distribution over one, that is not the wrapped environment's.
        SimulationDiverged: an episode blew up, so that it has no return; names its parameters.
    """
    episodes = whole_number("episodes", episodes, 2, " (for a standard error)")
    seed = seed_number(seed)
    made = None
    if isinstance(env, RandomizedParameters):
        if space is not None:
            check_space(space)
            space.check_same(env.space)
        wrapped, given = env, env.source if source is None else check_source(source, env.space)[0]
    else:
        if source is None and space is None:
            raise BadInput("give the parameters' space for an evaluation on the nominal model")
        made = wrapped = RandomizedParameters(make_environment(env), source, space)
        given = made.source
    vectors = episode_vectors(given, wrapped.space, episodes, seed)
    try:
        repetition = Repetition(wrapped, None if vectors is None else vectors[0])
        result = run_episodes(policy, wrapped, vectors, episodes, seed)
        repetition.check()
    except BadAction as error:
        raise BadInput(f"{error}: the fault is the policy's, not the simulation's; look at its weights") from None
    finally:
        if made is not None:
            made.close()
    return result if isinstance(given, Draws) or given is None else replace(result, given=len(given))


def run_episodes(
    policy: Predicts | Callable[[Any], Any], env: RandomizedParameters, vectors: Array | None, episodes: int, seed: int
) -> Evaluation:
    """`evaluate_policy` on vectors (episodes, D), or None for the nominal model, in an environment that was checked.

    Raises:
        BadInput: a policy that does not fit or gives actions that are not finite, a reward that is not, or episodes
            without an end.
        SimulationDiverged: an episode blew up.
    """
    if isinstance(policy, Policy) and policy.past_commands and not past_commands_of(env):
        policy = Controller(policy)
    actor = Actor(policy, env.action_space, env.label)
    seeds = np.random.SeedSequence(seed).generate_state(episodes)
    returns, lengths = np.zeros(episodes), np.zeros(episodes, np.int64)
    for i in range(episodes):
        options = None if vectors is None else {"parameters": vectors[i]}
        returns[i], lengths[i] = _episode(actor, env, int(seeds[i]), options)
    return Evaluation(returns, lengths, vectors)


def episode_vectors(source: Any, space: ParameterSpace, episodes: int, seed: int) -> Array | None:
    """Parameters of the episodes of an evaluation, (episodes, D); None for the nominal model.

    Args:
        source: a distribution, vectors (n, D) or None.
        space: what they mean.
        episodes: how many.
        seed: of draws.
    """
    if source is None:
        return None
    if isinstance(source, Draws):
        return space.check(np.asarray(source.sample(episodes, seed=seed), dtype=np.float64))
    array = space.check(source)
    if len(array) <= episodes:
        return array[np.arange(episodes) % len(array)]
    # the array's order may mean something (sorted, a grid): one vector of each stretch stands for the whole
    edges = np.arange(episodes + 1) * len(array) // episodes
    return array[np.random.default_rng(seed).integers(edges[:-1], edges[1:])]


def _episode(actor: Actor, env: RandomizedParameters, seed: int, options: dict[str, Any] | None) -> tuple[float, int]:
    observation, info = env.reset(seed=seed, options=options)
    actor.start()
    named = info["parameters"] or "nominal parameters"
    total, length, over = 0.0, 0, False
    while not over:
        if length == ENDLESS:
            raise BadInput(
                f"environment {env.label}: an episode did not end within {ENDLESS} control steps; give it an end, for "
                "example gymnasium.wrappers.TimeLimit(env, max_episode_steps=1000)"
            )
        try:
            action = actor.act(observation)
        except BadAction as error:
            raise BadAction(f"{error}, after {length} control steps of an episode with {named}") from None
        observation, reward, terminated, truncated, step_info = env.step(action)
        if step_info.get("diverged"):
            raise SimulationDiverged(
                f"the simulation diverged after {length} control steps of an episode with {named}: use a smaller "
                "timestep in the model, or tighter bounds"
            )
        if not np.isfinite(float(reward)):
            raise NotFinite(
                f"environment {env.label}: the reward is {reward} after {length + 1} control steps of an episode with "
                f"{named}; it must be finite"
            )
        total, length, over = total + float(reward), length + 1, bool(terminated or truncated)
    return total, length
