"""What a fault is: hooks into the making of the robot and into its physics steps."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from nfpde.bench.gap.plant import Plant

Array = NDArray[np.float64]
Values = dict[str, Any]


@dataclass
class Fault:
    """One fault of one robot; the hooks of this class do nothing.

    Attributes:
        target: element it sits at, "all", "world" or "contact".
        values: its true values, by the names that a diagnosis uses; floats or lists of floats.
        memory: what it remembers from step to step, part of the state of the robot.
    """

    target: str
    values: Values
    memory: dict[str, Any] = field(default_factory=dict)

    distorts: ClassVar[bool] = False
    """Whether the sensors show something else than the robot's state."""

    reading: ClassVar[str] = ""
    """How the name is meant, where engineers mean different things by it; "" for the plain way."""

    @classmethod
    def differs(cls, model: mujoco.MjModel, target: str) -> bool:
        """Whether that makes a difference at a target."""
        return True

    def build(self, spec: mujoco.MjSpec) -> None:
        """Change the robot's construction before it is compiled."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Change the compiled robot."""

    def begin(self, plant: Plant, ctrl: Array) -> None:
        """Set the memory at the start of an episode in which `ctrl` (nu,) has been commanded for long."""

    def command(self, plant: Plant, ctrl: Array) -> Array:
        """What the drive gets instead of `ctrl` (nu,), at a physics step; must not write into `ctrl`."""
        return ctrl

    def push(self, plant: Plant) -> None:
        """Add to `qfrc_applied` or `xfrc_applied`, or set limits, before a physics step."""

    def resist(self, plant: Plant) -> None:
        """The same after all pushes are known: friction, which answers to the other forces."""

    def after(self, plant: Plant) -> None:
        """Look at the robot after a physics step."""

    def observe(self, plant: Plant, qpos: Array, qvel: Array) -> tuple[Array, Array]:
        """What the sensors show instead of the robot's qpos (nq,) and qvel (nv,)."""
        return qpos, qvel

    def disturb(self, plant: Plant, dq: Array, dv: Array) -> None:
        """Shift remembered states by a measurement error, dq and dv (nv,)."""

    def remember(self) -> dict[str, Any]:
        """A copy of the memory."""
        return copy.deepcopy(self.memory)

    def recall(self, memory: dict[str, Any]) -> None:
        """Take up a memory that `remember` gave."""
        self.memory = copy.deepcopy(memory)


def joint_of(model: mujoco.MjModel, actuator: str) -> int:
    """Id of the joint that a named actuator moves."""
    return int(model.actuator(actuator).trnid[0])


def dof_of(model: mujoco.MjModel, joint: str) -> int:
    """Index into qvel of a named joint of one degree of freedom."""
    return int(model.joint(joint).dofadr[0])


def kind_of(model: mujoco.MjModel, actuator: int) -> str:
    """What an actuator takes: "torque", "position" or "velocity", read from its constants."""
    bias = model.actuator_biasprm[actuator]
    return "position" if bias[1] != 0 else "velocity" if bias[2] != 0 else "torque"
