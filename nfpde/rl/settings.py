"""What an environment is made of, as JSON: arguments, wrappers with theirs, length of episodes, spaces."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import TimeLimit

from nfpde.rl.randomize import RandomizedParameters

WATCHING = {
    "HumanRendering",
    "Monitor",
    "OrderEnforcing",
    "PassiveEnvChecker",
    "RecordEpisodeStatistics",
    "RecordVideo",
    "RenderCollection",
}
"""Wrappers that look on and change nothing."""

LOOKS = {
    "camera_id",
    "camera_name",
    "default_camera_config",
    "height",
    "max_geom",
    "render_mode",
    "visual_options",
    "width",
    "xml_file",  # where the file lies; what is in it is the model's hash
}
"""Arguments of environments that change nothing but pictures."""

MOST_NUMBERS = 64
"""Numbers of an array that are written out; of larger ones a fingerprint must do."""


def environment_settings(env: RandomizedParameters) -> dict[str, Any]:
    """What must be the same for two environments to be one task, as far as they tell.

    An environment that `gymnasium.make` made knows its arguments by name; of others those that `EzPickle` keeps are
    taken. Of wrappers count class and recorded arguments. Functions are told apart by name only: what they do shows
    in how the environment behaves (`nfpde.rl.behaviour`).

    Returns:
        `environment` (Gymnasium id or class), `arguments`, `wrappers` (outermost first), `max_episode_steps`,
        `observation_space` and `action_space`.
    """
    return {
        "environment": env.label,
        "arguments": _arguments(env.unwrapped),
        "wrappers": [
            {"name": type(w).__name__, "arguments": _plain(_recorded(w))}
            for w in layers(env)
            if isinstance(w, gymnasium.Wrapper) and type(w).__name__ not in WATCHING
        ],
        "max_episode_steps": episode_limit(env),
        "observation_space": _plain(env.observation_space),
        "action_space": _plain(env.action_space),
    }


def layers(env: Any) -> Iterator[Any]:
    """The wrappers of an environment from the outside in, without `RandomizedParameters`; last the bare environment."""
    while isinstance(env, gymnasium.Wrapper):
        if not isinstance(env, RandomizedParameters):
            yield env
        env = env.env
    yield env


def wrapper_names(env: Any) -> list[str]:
    """Classes of the wrappers that may change something, outermost first."""
    names = [type(layer).__name__ for layer in layers(env)][:-1]
    return [name for name in names if name not in WATCHING and name != TimeLimit.__name__]


def episode_limit(env: Any) -> int | None:
    """Control steps after which a `TimeLimit` ends an episode, None where there is none."""
    return min((int(layer._max_episode_steps) for layer in layers(env) if isinstance(layer, TimeLimit)), default=None)


def _arguments(bare: Any) -> dict[str, Any]:
    if getattr(bare, "spec", None) is not None:
        return {name: _plain(value) for name, value in sorted(bare.spec.kwargs.items()) if name not in LOOKS}
    unnamed = [_plain(v) for v in getattr(bare, "_ezpickle_args", ()) if not _is_model_file(v)]
    named = {n: _plain(v) for n, v in getattr(bare, "_ezpickle_kwargs", {}).items() if n not in LOOKS}
    return {**named, **({"unnamed": unnamed} if unnamed else {})}


def _is_model_file(value: Any) -> bool:
    return isinstance(value, str | Path) and Path(value).suffix in (".xml", ".mjb")


def _recorded(wrapper: Any) -> dict[str, Any]:
    """Arguments of a wrapper where it records them (`gymnasium.utils.RecordConstructorArgs`)."""
    if isinstance(wrapper, TimeLimit):  # its one argument is `max_episode_steps`
        return {}
    return {name: value for name, value in getattr(wrapper, "_saved_kwargs", {}).items() if name != "env"}


def _plain(value: Any) -> Any:
    """A value as JSON that is equal for equal values, in every process."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _numbers(value)
    if isinstance(value, gymnasium.spaces.Box):
        bounds = {"low": _numbers(value.low), "high": _numbers(value.high)}
        return {"shape": list(value.shape), "dtype": str(value.dtype), **bounds}
    if isinstance(value, gymnasium.Space):
        return str(value)
    return getattr(value, "__qualname__", type(value).__qualname__)


def _numbers(array: Any) -> Any:
    """An array's numbers, one where all are the same."""
    flat = array.ravel()
    if flat.size and (flat == flat[0]).all():
        return _plain(flat[0])
    if flat.size <= MOST_NUMBERS:
        return _plain(array.tolist())
    return f"{flat.size} numbers, {hashlib.sha256(np.ascontiguousarray(flat).tobytes()).hexdigest()[:16]}"
