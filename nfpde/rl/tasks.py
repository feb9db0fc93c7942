"""The tasks policies are trained for: a small pendulum of our own, and short names of Gymnasium's robots."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from numpy.typing import NDArray

from nfpde.errors import BadInput

TASKS = {
    "pendulum": "nfpde/Pendulum-v0",
    "hopper": "Hopper-v5",
    "walker2d": "Walker2d-v5",
    "half_cheetah": "HalfCheetah-v5",
    "humanoid": "Humanoid-v5",
}
"""Short names and the Gymnasium ids they stand for."""

PENDULUM_XML = Path(__file__).parent / "assets" / "pendulum.xml"

Environment = str | Callable[[], gymnasium.Env[Any, Any]]


class Pendulum(MujocoEnv):
    """Swing a pendulum up and hold it, with a motor that must pump because it cannot lift the bob.

    Body `pendulum`, joint `hinge` [rad, 0 hangs down], actuator `motor` [Nm]. An episode has 150 steps of 0.05 s
    and starts at any angle, with at most 1 rad/s. Observation: cosine and sine of the angle from upright, angular
    velocity [rad/s]. Reward a step: (1 + cosine) / 2 less 0.002 velocity^2 and 0.02 (torque / limit)^2, so that
    holding the pendulum upright earns nearly 1 and hanging still 0.

    Args:
        xml_file: another MJCF with the same joint and actuator.
        **kwargs: of `gymnasium.envs.mujoco.MujocoEnv`: render_mode, width, height ...
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[reportIncompatibleVariableOverride]
        "render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"],
        "render_fps": 20,
    }

    def __init__(self, xml_file: str | Path = PENDULUM_XML, **kwargs: Any) -> None:
        high = np.array([1.0, 1.0, np.inf])
        space = gymnasium.spaces.Box(-high, high, dtype=np.float64)
        super().__init__(str(Path(xml_file).resolve()), 5, space, camera_name="side", **kwargs)

    def reset_model(self) -> NDArray[np.float64]:
        """Start anywhere on the circle, slowly."""
        self.set_state(self.np_random.uniform(-np.pi, np.pi, 1), self.np_random.uniform(-1.0, 1.0, 1))
        return self._get_obs()

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float64], Any, bool, bool, dict[str, Any]]:
        """Apply a torque [Nm], (1,), for one control step."""
        self.do_simulation(action, self.frame_skip)
        effort = float(action[0]) / float(self.action_space.high[0])  # type: ignore[attr-defined]
        angle, velocity = float(self.data.qpos[0]), float(self.data.qvel[0])
        reward = (1 - np.cos(angle)) / 2 - 0.002 * velocity**2 - 0.02 * effort**2
        if self.render_mode == "human":
            self.render()
        return self._get_obs(), float(reward), False, False, {}

    def _get_obs(self) -> NDArray[np.float64]:
        angle, velocity = self.data.qpos[0], self.data.qvel[0]
        return np.array([-np.cos(angle), -np.sin(angle), velocity])


def make_environment(name: Environment, model: str | Path | None = None) -> gymnasium.Env[Any, Any]:
    """An environment by its short name (`TASKS`) or Gymnasium id, or from a function that makes one.

    Args:
        name: `hopper`, `Hopper-v5`, `my_package:MyRobot-v0`, or a function without arguments.
        model: an MJCF file to use in place of the environment's own (its argument `xml_file`).

    Raises:
        BadInput: no such environment, or one that takes no `xml_file`.
    """
    if not isinstance(name, str):
        if model is not None:
            raise BadInput("a model file goes with the name of an environment; let your function load it")
        return name()
    if model is not None and not Path(model).is_file():
        raise BadInput(f"{model}: no such file; give the path of an MJCF file")
    arguments: dict[str, Any] = {} if model is None else {"xml_file": str(Path(model).resolve())}
    try:
        return gymnasium.make(TASKS.get(name, name), disable_env_checker=True, **arguments)
    except (gymnasium.error.Error, ImportError) as error:
        raise BadInput(
            f"environment {name!r}: {error} Known short names: {', '.join(TASKS)}; any Gymnasium id of a MuJoCo "
            "environment works too, as module:Id-v0 where a module must be imported first"
        ) from None
    except TypeError as error:
        raise BadInput(f"environment {name!r} cannot be made with {arguments}: {error}") from None


if TASKS["pendulum"] not in gymnasium.registry:
    gymnasium.register(TASKS["pendulum"], entry_point=f"{__name__}:Pendulum", max_episode_steps=150)
