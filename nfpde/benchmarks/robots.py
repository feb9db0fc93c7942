"""The four robots of the paper's experiments and which of their parameters are unknown (Table I)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import gymnasium
import mujoco

from nfpde.benchmarks.pendulum import PAYLOAD_ID, PAYLOAD_XML, PENDULUM_ID, PENDULUM_XML
from nfpde.elements import element_names
from nfpde.errors import BadInput
from nfpde.parameters import Parameter, ParameterSpace, Target
from nfpde.sim import load_model

SPREAD = 0.5
"""Bounds lie this share below and above the nominal value."""


@dataclass(frozen=True)
class Robot:
    """A robot with a Gymnasium environment and unknown masses, joint dampings and floor friction.

    Bounds are the nominal value -50 % and +50 %: the paper prints none.

    Attributes:
        name: for the command line.
        env_id: Gymnasium's id.
        asset: file of the model among Gymnasium's, or a whole path.
        masses: bodies (a tuple: they share one mass, as the left and right leg of one robot do).
        dampings: joints, likewise.
        friction: the element whose sliding friction gives the nominal value, or None. A contact takes the larger
            coefficient of its two geoms, so the parameter sets all geoms alike.
    """

    name: str
    env_id: str
    asset: str
    masses: tuple[Target, ...]
    dampings: tuple[Target, ...]
    friction: str | None = None

    @property
    def path(self) -> Path:
        """The model's file."""
        return Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / self.asset

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The nominal model, as every simulator of this package loads it."""
        return load_model(self.path)

    @cached_property
    def space(self) -> ParameterSpace:
        """The unknown parameters: masses, dampings, friction."""
        parameters = [
            *(self._parameter("body_mass", t, "body", self.model.body_mass) for t in self.masses),
            *(self._parameter("dof_damping", t, "joint", self._joint_damping()) for t in self.dampings),
        ]
        if self.friction is not None:
            i = element_names(self.model, "geom").index(self.friction)
            nominal = float(self.model.geom_friction[i, 0])
            low, high = nominal * (1 - SPREAD), nominal * (1 + SPREAD)
            parameters.append(Parameter("geom_friction", "*", low, high, name="geom_friction:floor"))
        return ParameterSpace(parameters)

    def _joint_damping(self) -> list[float]:
        return [float(self.model.dof_damping[d]) for d in self.model.jnt_dofadr]

    def _parameter(self, field: str, target: Target, kind: str, values: list[float]) -> Parameter:
        first = target[0] if isinstance(target, tuple) else target
        nominal = float(values[element_names(self.model, kind).index(str(first))])
        return Parameter(field, target, nominal * (1 - SPREAD), nominal * (1 + SPREAD))


_HUMANOID_BODIES = (
    *("torso", "lwaist", "pelvis", "right_thigh", "right_shin", "right_foot", "left_thigh", "left_shin", "left_foot"),
    *("right_upper_arm", "right_lower_arm", "left_upper_arm", "left_lower_arm"),
)
_HUMANOID_JOINTS = (
    *("abdomen_z", "abdomen_y", "abdomen_x", "right_hip_x", "right_hip_z", "right_hip_y", "right_knee"),
    *("left_hip_x", "left_hip_z", "left_hip_y", "left_knee", "right_shoulder1", "right_shoulder2", "right_elbow"),
    *("left_shoulder1", "left_shoulder2", "left_elbow"),
)
_CHEETAH_LEGS = ("bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot")

ROBOTS = {
    robot.name: robot
    for robot in (
        Robot("hopper", "Hopper-v5", "hopper.xml", ("torso", "thigh", "leg", "foot"), ("thigh_joint", "leg_joint")),
        Robot(
            "walker2d",
            "Walker2d-v5",
            "walker2d_v5.xml",
            ("torso", ("thigh", "thigh_left"), ("leg", "leg_left"), ("foot", "foot_left")),
            (("thigh_joint", "thigh_left_joint"), ("leg_joint", "leg_left_joint")),
            friction="foot_geom",
        ),
        Robot(
            "half_cheetah",
            "HalfCheetah-v5",
            "half_cheetah.xml",
            ("torso", *_CHEETAH_LEGS),
            _CHEETAH_LEGS,
            friction="floor",
        ),
        Robot("humanoid", "Humanoid-v5", "humanoid.xml", _HUMANOID_BODIES, _HUMANOID_JOINTS),
    )
}
"""The paper's robots by name: 6, 7, 14 and 30 parameters."""

BENCHMARKS = {
    **ROBOTS,
    "pendulum": Robot("pendulum", PENDULUM_ID, str(PENDULUM_XML), ("pendulum",), ("hinge",)),
    "payload": Robot("payload", PAYLOAD_ID, str(PAYLOAD_XML), ("hand", "payload"), ("hinge",)),
}
"""All robots by name: the paper's, a pendulum with 2 parameters on which the whole way takes minutes, and one with 3 of
which no recording tells how its hand and its payload share their mass."""


def robot(name: str) -> Robot:
    """The robot of that name.

    Raises:
        BadInput: there is none.
    """
    if name not in BENCHMARKS:
        raise BadInput(f"no benchmark robot is called {name!r}; there are: {', '.join(BENCHMARKS)}")
    return BENCHMARKS[name]
