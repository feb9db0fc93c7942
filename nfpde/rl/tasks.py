"""The tasks policies are trained for, by short names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium

from nfpde.benchmarks import PAYLOAD_ID, PENDULUM_ID
from nfpde.errors import BadInput, BadModel
from nfpde.sim.quiet import quiet_mujoco

TASKS = {
    "pendulum": PENDULUM_ID,
    "payload": PAYLOAD_ID,
    "hopper": "Hopper-v5",
    "walker2d": "Walker2d-v5",
    "half_cheetah": "HalfCheetah-v5",
    "humanoid": "Humanoid-v5",
}
"""Short names and the Gymnasium ids they stand for."""

Environment = str | Callable[[], gymnasium.Env[Any, Any]]


def make_environment(name: Environment, model: str | Path | None = None) -> gymnasium.Env[Any, Any]:
    """An environment by its short name (`TASKS`) or Gymnasium id, or from a function that makes one.

    Args:
        name: `hopper`, `Hopper-v5`, `my_package:MyRobot-v0`, or a function without arguments.
        model: an MJCF file to use in place of the environment's own (its argument `xml_file`).

    Raises:
        BadInput: no such environment, or one that takes no `xml_file`.
        BadModel: MuJoCo cannot compile the file.
    """
    if not isinstance(name, str):
        if model is not None:
            raise BadInput("a model file goes with the name of an environment; let your function load it")
        return name()
    if model is not None and not Path(model).is_file():
        raise BadInput(f"{model}: no such file; give the path of an MJCF file")
    if name.count(":") > 1 or name.startswith(":"):
        raise BadInput(f"environment {name!r}: give a Gymnasium id, or MODULE:Id-v0 with one colon")
    arguments: dict[str, Any] = {} if model is None else {"xml_file": str(Path(model).resolve())}
    try:
        with quiet_mujoco():
            return gymnasium.make(TASKS.get(name, name), disable_env_checker=True, **arguments)
    except (gymnasium.error.Error, ImportError) as error:
        raise BadInput(
            f"environment {name!r}: {error} Known short names: {', '.join(TASKS)}; any Gymnasium id of a MuJoCo "
            "environment works too, as module:Id-v0 where a module must be imported first"
        ) from None
    except ValueError as error:
        if model is None:
            raise
        raise BadModel(f"{model}: environment {name!r} cannot be made with it: {error}") from None
    except TypeError as error:
        raise BadInput(f"environment {name!r} cannot be made with {arguments}: {error}") from None
