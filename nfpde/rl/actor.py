"""Asking a policy for actions, whatever kind it is, and refusing what no environment can take."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from nfpde.errors import BadInput


class NotFinite(BadInput):
    """A number of an environment's or of a learner's that is NaN or infinite."""


class BadAction(NotFinite):
    """A policy's action that is NaN or infinite."""


class Predicts(Protocol):
    """A policy: `Policy`, or an agent of Stable-Baselines3."""

    def predict(self, observation: Any) -> Any:
        """Action for one observation, or a tuple that starts with it."""
        ...


class Actor:
    """A policy at work in episodes, one after the other.

    Agents of Stable-Baselines3 act without exploration (`deterministic=True`), and recurrent ones are given the state
    that they returned (`state`) and where an episode begins (`episode_start`): each argument where the policy names it.

    Args:
        policy: has `predict(observation)`, or is a function from observation to action.
        space: actions that the environment takes.
        label: the environment's name, for messages.

    Raises:
        BadInput: neither.
    """

    def __init__(
        self, policy: Predicts | Callable[[Any], Any], space: gymnasium.Space[Any], label: str = "the environment"
    ) -> None:
        self._predict: Any = getattr(policy, "predict", policy)
        if not callable(self._predict):
            raise BadInput(
                "a policy has a method predict(observation) or is a function from observation to action, got a "
                f"{type(policy).__name__}"
            )
        self._names = _keywords(self._predict)
        self._space = space
        self._label = label
        self.start()

    def start(self) -> None:
        """An episode begins: forget the state of the last one."""
        self._state: Any = None
        self._first = True

    def act(self, observation: Any) -> Any:
        """Action for the next observation of the episode.

        Raises:
            BadAction: the action holds a number that is not finite.
            BadInput: it has another shape than those the environment takes, or is no array of numbers.
        """
        values = {"deterministic": True, "state": self._state, "episode_start": np.array([self._first])}
        found = self._predict(observation, **{name: values[name] for name in values if name in self._names})
        self._first = False
        action = found
        if isinstance(found, tuple):
            action = found[0]
            self._state = found[1] if len(found) > 1 else None
        self._check(action)
        return action

    def _check(self, action: Any) -> None:
        if self._space.shape is None:  # several spaces in one: the environment's own checks must do
            return
        try:
            numbers = np.asarray(action)
        except (TypeError, ValueError, RuntimeError):  # rows of different lengths, a tensor that is being derived
            numbers = np.empty(0, dtype=object)
        if numbers.dtype.kind not in "biuf":
            raise BadInput(f"the policy gives {action!r:.80} for an action; it must be an array of numbers")
        if numbers.shape != self._space.shape:
            raise BadInput(
                f"the policy gives actions of shape {numbers.shape}, environment {self._label} takes "
                f"{self._space.shape}: give the policy of this robot"
            )
        check_finite(numbers)


def check_finite(action: NDArray[Any]) -> None:
    """Refuse an action that no simulation can take.

    Raises:
        BadAction: it holds a number that is not finite.
    """
    if not np.isfinite(action).all():
        raise BadAction(f"the policy gave the action {np.array2string(action, threshold=8)}, which is not finite")


def _keywords(function: Callable[..., Any]) -> set[str]:
    """Names of the arguments that a function takes by name, beside the first, which the observation is."""
    try:
        parameters = list(inspect.signature(function).parameters.values())[1:]
    except (TypeError, ValueError):  # some built-in functions do not tell
        return set()
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {p.name for p in parameters if p.kind in by_name}
