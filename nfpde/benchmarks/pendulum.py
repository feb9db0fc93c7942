"""Small pendulums of our own: recorded, fitted and mastered within minutes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from numpy.typing import NDArray

ASSETS = Path(__file__).parent / "assets"

PENDULUM_ID = "nfpde/Pendulum-v0"
PENDULUM_XML = ASSETS / "pendulum.xml"

PAYLOAD_ID = "nfpde/Payload-v0"
PAYLOAD_XML = ASSETS / "payload.xml"
"""A pendulum whose bob is a hand and what it holds: no motion tells how they share their mass."""


class Pendulum(MujocoEnv):
    """Swing a pendulum up and hold it, with a motor that must pump because it cannot lift the bob.

    Joint `hinge` [rad, 0 hangs down], actuator `motor` [Nm]. An episode has 150 steps of 0.05 s
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


for env_id, xml_file in ((PENDULUM_ID, PENDULUM_XML), (PAYLOAD_ID, PAYLOAD_XML)):
    if env_id not in gymnasium.registry:
        given = {"xml_file": str(xml_file)}
        gymnasium.register(env_id, entry_point=f"{__name__}:Pendulum", max_episode_steps=150, kwargs=given)
