"""How an environment behaves: two seeded episodes under fixed actions, which tell whether it is still the same."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.errors import BadInput, SimulationDiverged
from nfpde.live import numbers_of
from nfpde.rl.randomize import RandomizedParameters
from nfpde.rl.settings import layers, wrapper_names

Array = NDArray[np.float64]

SEEDS = (0, 1)
"""One for each test episode."""
STEPS = 10
"""Control steps whose numbers are compared: too few for contacts to make rounding visible."""
LONGEST = 50
"""Control steps within which the end of a test episode is looked for."""
RELATIVE, ABSOLUTE = 1e-6, 1e-7
"""Differences that count as rounding: observations may be of single precision."""


def observe(env: RandomizedParameters, xi: Array | None) -> dict[str, Any]:
    """Observations, rewards and ends of test episodes, which equal settings of an environment make equal.

    Args:
        env: the environment.
        xi: the episodes' parameters (D,), None for a nominal model.

    Returns:
        `parameters`, and `episodes` with `observations` ([n] by step), `rewards` (steps,) and `length` (control
        steps until the end, None where it was not reached) each; arrays, lists and numbers only.
    """
    actions: Any = deepcopy(env.action_space)  # the environment's own draws are left as they are
    actions.seed(0)
    return {"parameters": xi, "episodes": [_episode(env, xi, seed, actions) for seed in SEEDS]}


def _episode(env: RandomizedParameters, xi: Array | None, seed: int, actions: Any) -> dict[str, Any]:
    observations: list[Array] = []
    rewards: list[float] = []
    try:
        observation, _ = env.reset(seed=seed, options=None if xi is None else {"parameters": xi})
    except SimulationDiverged:  # that is told, or counted, where it matters
        return {"observations": observations, "rewards": np.array(rewards), "length": 0}
    observations.append(numbers_of(observation))
    length = None
    for step in range(1, LONGEST + 1):
        observation, reward, terminated, truncated, _ = env.step(actions.sample())
        if step <= STEPS:
            observations.append(numbers_of(observation))
            rewards.append(float(reward))
        if terminated or truncated:
            length = step
            break
    return {"observations": observations, "rewards": np.array(rewards), "length": length}


def difference(first: dict[str, Any], second: dict[str, Any]) -> tuple[str, str, str] | None:
    """The first difference of two behaviours beyond rounding: what it is, and both its values; None for none."""
    for seed, one, other in zip(SEEDS, first["episodes"], second["episodes"], strict=True):
        where = f"in a test episode of seed {seed}"
        lengths = one["length"], other["length"]
        for step, (x, y) in enumerate(zip(one["observations"], other["observations"], strict=False)):
            if x.shape != y.shape:
                return f"size of the observation {where}", str(x.size), str(y.size)
            wrong = np.flatnonzero(~_close(x, y))
            if wrong.size:
                i = wrong[0]
                return f"observation[{i}] after {step} control steps {where}", f"{x[i]:.8g}", f"{y[i]:.8g}"
        n = min(len(one["rewards"]), len(other["rewards"]))
        wrong = np.flatnonzero(~_close(one["rewards"][:n], other["rewards"][:n]))
        if wrong.size:
            i = wrong[0]
            values = one["rewards"][i], other["rewards"][i]
            return f"reward of control step {i + 1} {where}", f"{values[0]:.8g}", f"{values[1]:.8g}"
        if lengths[0] != lengths[1]:
            texts = [f"more than {LONGEST}" if n is None else str(n) for n in lengths]
            return f"control steps {where}", texts[0], texts[1]
    return None


class Repetition:
    """Watches that equal seeds and actions give equal episodes, whatever ran in between.

    Args:
        env: the environment.
        xi: parameters of the test episodes (D,), None for a nominal model.

    Raises:
        BadInput: a wrapper keeps statistics of what it has seen.
    """

    def __init__(self, env: RandomizedParameters, xi: Array | None) -> None:
        check_statistics(env)
        self.env = env
        self.behaviour = observe(env, xi)

    def check(self) -> None:
        """Run the test episodes again.

        Raises:
            BadInput: they came out otherwise; names the difference.
        """
        found = difference(self.behaviour, observe(self.env, self.behaviour["parameters"]))
        if found is None:
            return
        names = wrapper_names(self.env)
        inside = f" (its wrappers: {', '.join(names)})" if names else ""
        raise BadInput(
            f"environment {self.env.label}{inside} carries something over from one episode to the next: {found[0]} "
            f"was {found[1]} at first and {found[2]} after others had run. Returns would not be comparable, and a "
            "training could not go on exactly: let reset() set everything back, draw random numbers from np_random, "
            "which reset(seed=...) seeds, and scale by fixed numbers"
        )


def check_statistics(env: RandomizedParameters) -> None:
    """Refuse wrappers whose output depends on running statistics that still change.

    Raises:
        BadInput: names the wrapper, and what to use in its place.
    """
    for layer in layers(env):
        kept = [
            name
            for name, value in vars(layer).items()
            if any(kind.__name__ == "RunningMeanStd" for kind in type(value).__mro__)
        ]
        if kept and getattr(layer, "update_running_mean", True):
            raise BadInput(
                f"environment {env.label}: {type(layer).__name__} scales by statistics of the episodes it has seen "
                f"({', '.join(kept)}), which no policy and no saved training holds: equal states would look different "
                "in another environment. "
                "Scale by fixed numbers (gymnasium.wrappers.TransformObservation, TransformReward), or give it fixed "
                "statistics and set update_running_mean to False"
            )


def _close(first: Array, second: Array) -> NDArray[np.bool_]:
    return np.isclose(second, first, rtol=RELATIVE, atol=ABSOLUTE, equal_nan=True)
