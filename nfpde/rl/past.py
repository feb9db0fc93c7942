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
    """Appends the last n actions to the observation, oldest first; those before an episode's first are zero.

    An observation of a robot whose commands act late does not tell what it will do next: commands are under way. With
    them the task is a Markov decision process again (Katsikopoulos and Engelbrecht, Markov decision processes with
    delays and asynchronous cost collection, 2003).

    Args:
        env: with observations and actions that are arrays of numbers.
        n: how many, at least 1.

    Raises:
        BadInput: other observations or actions.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], n: int) -> None:
        RecordConstructorArgs.__init__(self, n=n)
        super().__init__(env)
        seen, acts = (
            _row(what, space)
            for what, space in (("observations", env.observation_space), ("actions", env.action_space))
        )
        self.observation_space = gymnasium.spaces.Box(
            np.concatenate([seen.low, np.tile(np.minimum(acts.low, 0), n)], dtype=np.float64),
            np.concatenate([seen.high, np.tile(np.maximum(acts.high, 0), n)], dtype=np.float64),
            dtype=np.float64,
        )
        self.memory = Memory(whole_number("n", n, 1), acts.shape[0])

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
    """The last n commands (nu,), zero where there were none yet."""

    def __init__(self, n: int, nu: int) -> None:
        self._none = np.zeros(nu)
        self._past = deque([self._none] * n, maxlen=n)

    def clear(self) -> None:
        """Forget them all."""
        self._past.extend([self._none] * (self._past.maxlen or 0))

    def add(self, command: ArrayLike) -> None:
        """One more; the oldest is forgotten."""
        self._past.append(np.array(command, dtype=np.float64))

    def beside(self, observation: ArrayLike) -> Array:
        """An observation with the commands behind it."""
        return np.concatenate([np.asarray(observation, dtype=np.float64), *self._past])


class Controller:
    """A policy at work on a robot: remembers the commands that it has given, where the policy wants to see them.

    Args:
        policy: what `load_policy` returned.

    Example:
        On a robot, once every control step::

            controller = Controller(load_policy("runs/policy"))
            while running:
                send(controller.act(measure()))
    """

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._memory = Memory(policy.past_commands, len(policy.low))

    def reset(self) -> None:
        """The robot was at rest, or moved by something else: forget the commands given."""
        self._memory.clear()

    def act(self, observation: ArrayLike) -> NDArray[np.float32]:
        """The command (nu,) for what the environment's observation is on the robot.

        Raises:
            BadInput: what `Policy.predict` refuses.
        """
        command = self.policy.predict(self._memory.beside(observation))
        self._memory.add(command)
        return command
