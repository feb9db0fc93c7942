"""How a policy in training does in one environment: the same episodes after every round."""

from __future__ import annotations

from typing import Any

from nfpde.errors import SimulationDiverged
from nfpde.rl.behaviour import Repetition
from nfpde.rl.evaluate import episode_vectors, run_episodes
from nfpde.rl.history import Score
from nfpde.rl.policy import Policy
from nfpde.rl.randomize import RandomizedParameters


class Scoring:
    """Evaluates policies in an environment on parameters from its source, and watches that it stays the same.

    Args:
        env: the environment.
        episodes: of each evaluation.
        seed: of draws and start states.

    Raises:
        BadInput: a wrapper keeps statistics of what it has seen.
    """

    def __init__(self, env: RandomizedParameters, episodes: int, seed: int) -> None:
        self.env = env
        self.episodes = episodes
        self.seed = seed
        self.vectors = episode_vectors(env.source, env.space, episodes, seed)
        self.repetition = Repetition(env, None if self.vectors is None else self.vectors[0])

    @property
    def behaviour(self) -> dict[str, Any]:
        """What `nfpde.rl.behaviour.observe` saw at first."""
        return self.repetition.behaviour

    def score(self, policy: Policy) -> Score:
        """Returns of a policy, or what became of a simulation that diverged.

        Raises:
            BadInput: the environment carries something over from one episode to the next, its episodes do not end, or
                a reward or an action is not finite.
        """
        try:
            found = run_episodes(policy, self.env, self.vectors, self.episodes, self.seed)
            score = Score(found.mean, found.standard_error, tuple(found.returns.tolist()))
        except SimulationDiverged as error:
            score = Score(None, None, problem=str(error))
        self.repetition.check()
        return score
