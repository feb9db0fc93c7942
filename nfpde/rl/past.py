"""Commands of the last control steps as part of what a policy sees: where they act late, it must know them."""

from __future__ import annotations

from collections import deque
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import ArrayLike, NDArray

from nfpde.errors import BadInput
from nfpde.rl.numbers import whole_number
from nfpde.rl.policy import Policy

Array = NDArray[np.float64]


class PastCommands(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Appends the last n actions to the observation, oldest first.

    An observation of a robot whose commands act late does not tell what it will do next: commands are under way. With
    them the task is a Markov decision process again (Katsikopoulos and Engelbrecht, Markov decision processes with
    delays and asynchronous cost collection, 2003).

    Before an episode's first action they are zero. The first counts as the one that was given before, too, as in
    recordings and under `RandomizedParameters`: after it the observation ends with n times that action.

    Args:
        env: with observations and actions that are arrays of numbers.
        n: how many, at least 1.

    Raises:
        BadInput: other observations or actions.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], n: int) -> None:
        n = whole_number("n", n, 1)
        RecordConstructorArgs.__init__(self, n=n)
        super().__init__(env)
        self.n = n
        seen = _row("observations", env.observation_space)
        acts = _row("actions", env.action_space)
        self.observation_space = gymnasium.spaces.Box(
            np.concatenate([seen.low, np.tile(np.minimum(acts.low, 0), n)], dtype=np.float64),
            np.concatenate([seen.high, np.tile(np.maximum(acts.high, 0), n)], dtype=np.float64),
            dtype=np.float64,
        )
        self.memory = Memory(n, acts.shape[0])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode with nothing under way."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.memory.clear()
        return self.memory.beside(observation), info

    def step(self, action: Any) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Advance by one control step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.memory.add(action)
        return self.memory.beside(observation), reward, terminated, truncated, info


def _row(what: str, space: gymnasium.Space[Any]) -> gymnasium.spaces.Box:
    if isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 1:
        return space
    raise BadInput(
        f"past commands go with {what} that are a row of numbers, this environment's are {space}; flatten them first "
        "(gymnasium.wrappers.FlattenObservation), or train without past commands"
    )


class Memory:
    """The last n commands (nu,): zero before the first, which counts as all those before it."""

    def __init__(self, n: int, nu: int) -> None:
        self._n, self._none = n, np.zeros(nu)
        self.clear()

    def clear(self) -> None:
        """Forget them all."""
        self._past = deque([self._none] * self._n, maxlen=self._n)
        self._begun = False

    def add(self, command: ArrayLike) -> None:
        """One more; the oldest is forgotten."""
        given = np.array(command, dtype=np.float64)
        self._past.extend([given] if self._begun else [given] * self._n)
        self._begun = True

    def beside(self, observation: ArrayLike) -> Array:
        """An observation with the commands behind it."""
        return np.concatenate([np.asarray(observation, dtype=np.float64), *self._past])


class Controller:
    """A policy at work on a robot: remembers the commands that it has given, where the policy wants to see them.

    Args:
        policy: what `load_policy` returned.

    Raises:
        BadInput: something else.

    Example:
        On a robot, once every control step::

            controller = Controller(load_policy("runs/policy"))
            while running:
                send(controller.act(measure()))
    """

    def __init__(self, policy: Policy) -> None:
        if not isinstance(policy, Policy):
            raise BadInput(f"a controller runs what load_policy returns, got a {type(policy).__name__}")
        self.policy = policy
        self._memory = Memory(policy.past_commands, len(policy.low))

    def reset(self) -> None:
        """The robot starts anew: forget the commands given."""
        self._memory.clear()

    def act(self, observation: ArrayLike) -> NDArray[np.float32]:
        """The command (nu,) for what the environment's observation is on the robot.

        Raises:
            BadInput: an observation of another size, or one that is not finite.
        """
        try:
            seen = np.asarray(observation, dtype=np.float64)
        except (TypeError, ValueError):
            raise BadInput(f"an observation is a row of numbers, got {observation!r:.80}") from None
        own = self.policy.nobservation - self.policy.past_commands * len(self.policy.low)
        if seen.shape != (own,):
            raise BadInput(
                f"this policy takes observations of {own} numbers (and adds its own last {self.policy.past_commands} "
                f"commands), got an array of shape {seen.shape}"
            )
        command = self.policy.predict(self._memory.beside(seen))
        self._memory.add(command)
        return command

    def predict(self, observation: ArrayLike, episode_start: ArrayLike = False) -> NDArray[np.float32]:
        """`act`, for evaluations: an episode that starts begins without commands."""
        if np.any(episode_start):
            self.reset()
        return self.act(observation)


def past_commands_of(env: gymnasium.Env[Any, Any]) -> int:
    """How many commands the observations of an environment hold already."""
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, PastCommands):
            return env.n
        env = env.env
    return 0
