"""The tasks policies are trained for, by short names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium

from nfpde.benchmarks import PAYLOAD_ID, PENDULUM_ID
from nfpde.errors import BadInput, BadModel, NfpdeError
from nfpde.sim import load_model
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
        BadInput: no such environment, or one that takes no `xml_file`; neither a name nor a function that makes one.
        BadModel: MuJoCo cannot compile the file, or the environment needs another timestep.
    """
    if not isinstance(name, str):
        return _made_by(name, model)
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
    except (ValueError, AssertionError) as error:
        if model is None:
            raise
        needed = _timesteps(name, Path(model)) if isinstance(error, AssertionError) else None
        raise BadModel(f"{model}: environment {name!r} cannot be made with it: {needed or error}") from None
    except TypeError as error:
        raise BadInput(f"environment {name!r} cannot be made with {arguments}: {error}") from None


def _made_by(maker: Any, model: str | Path | None) -> gymnasium.Env[Any, Any]:
    if isinstance(maker, gymnasium.Env) or not callable(maker):
        raise BadInput(
            f"env is a {type(maker).__name__}; give an environment's name or a function that makes it: two are needed, "
            "for training and for the target"
        )
    if model is not None:
        raise BadInput("a model file goes with the name of an environment; let your function load it")
    made = maker()
    if not isinstance(made, gymnasium.Env):
        raise BadInput(f"the function that makes the environment returned a {type(made).__name__}, no gymnasium.Env")
    return made


def _timesteps(name: str, model: Path) -> str | None:
    """What is wrong with a model's timestep in an environment whose pictures come at a fixed rate; None if nothing."""
    try:
        own: Any = make_environment(name)
    except (NfpdeError, TypeError, ValueError, AssertionError):  # it has no model of its own to compare with
        return None
    needed, found = own.unwrapped.model.opt.timestep, load_model(model).opt.timestep
    own.close()
    if needed == found:
        return None
    return f"its timestep is {found:g} s, and the environment needs {needed:g} s (its render_fps is fixed); change it"
