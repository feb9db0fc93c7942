"""Faults of measuring and timing: encoder zero and scale, late readings, a wrong clock."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from nfpde.bench.gap.faults.base import Array, Fault, dof_of

if TYPE_CHECKING:
    from nfpde.bench.gap.plant import Plant


class EncoderZero(Fault):
    """The encoder shows the angle plus `offset`; a servo that reads it stands off by as much."""

    distorts = True

    def alter(self, model: mujoco.MjModel) -> None:
        """Let position servos on the joint act on the shifted reading."""
        for i in _servos(model, self.target):
            model.actuator_biasprm[i, 0] += (
                model.actuator_biasprm[i, 1] * model.actuator_gear[i, 0] * self.values["offset"]
            )

    def observe(self, plant: Plant, qpos: Array, qvel: Array) -> tuple[Array, Array]:
        """Shift the reading."""
        qpos = qpos.copy()
        qpos[plant.model.joint(self.target).qposadr[0]] += self.values["offset"]
        return qpos, qvel


class EncoderScale(Fault):
    """The encoder shows `scale` times the angle, and so does the speed; a servo that reads it acts on that."""

    distorts = True

    def alter(self, model: mujoco.MjModel) -> None:
        """Scale the feedback of servos on the joint."""
        for i in _servos(model, self.target):
            model.actuator_biasprm[i, 1:3] *= self.values["scale"]

    def observe(self, plant: Plant, qpos: Array, qvel: Array) -> tuple[Array, Array]:
        """Scale the readings."""
        qpos, qvel = qpos.copy(), qvel.copy()
        qpos[plant.model.joint(self.target).qposadr[0]] *= self.values["scale"]
        qvel[dof_of(plant.model, self.target)] *= self.values["scale"]
        return qpos, qvel


class LoggedZero(EncoderZero):
    """The log alone is off: the servo reads another encoder, or the log was shifted afterwards."""

    reading = "log"

    @classmethod
    def differs(cls, model: mujoco.MjModel, target: str) -> bool:
        """Where a servo reads the joint."""
        return bool(_servos(model, target))

    def alter(self, model: mujoco.MjModel) -> None:
        """Nothing."""


class LoggedScale(EncoderScale):
    """The log alone is scaled."""

    reading = "log"

    @classmethod
    def differs(cls, model: mujoco.MjModel, target: str) -> bool:
        """Where a servo reads the joint."""
        return bool(_servos(model, target))

    def alter(self, model: mujoco.MjModel) -> None:
        """Nothing."""


class LoggedPositionScale(EncoderScale):
    """The angles in the log alone are scaled; its speeds come from elsewhere, and are right."""

    reading = "positions in the log"

    def alter(self, model: mujoco.MjModel) -> None:
        """Nothing."""

    def observe(self, plant: Plant, qpos: Array, qvel: Array) -> tuple[Array, Array]:
        """Scale the angle."""
        qpos = qpos.copy()
        qpos[plant.model.joint(self.target).qposadr[0]] *= self.values["scale"]
        return qpos, qvel


class LateReading(Fault):
    """All readings are `delay` old when they are written down."""

    distorts = True

    def begin(self, plant: Plant, ctrl: Array) -> None:
        """The robot was at its start before."""
        steps = round(self.values["delay"] / plant.model.opt.timestep)
        now = (plant.data.qpos.copy(), plant.data.qvel.copy())
        self.memory = {"line": [now] * (steps + 1)}

    def after(self, plant: Plant) -> None:
        """Put the new state in, take the oldest out."""
        self.memory["line"].append((plant.data.qpos.copy(), plant.data.qvel.copy()))
        self.memory["line"].pop(0)

    def observe(self, plant: Plant, qpos: Array, qvel: Array) -> tuple[Array, Array]:
        """The oldest state in the line."""
        return self.memory["line"][0]

    def disturb(self, plant: Plant, dq: Array, dv: Array) -> None:
        """Shift the whole line: a prediction starts from a late reading too."""
        line = []
        for qpos, qvel in self.memory["line"]:
            shifted = qpos.copy()
            mujoco.mj_integratePos(plant.model, shifted, dq, 1.0)
            line.append((shifted, qvel + dv))
        self.memory = {"line": line}

    def remember(self) -> dict[str, Any]:
        """The line; its arrays are never written to, so they are shared."""
        return {"line": list(self.memory["line"])}

    def recall(self, memory: dict[str, Any]) -> None:
        """Take a line up again."""
        self.memory = {"line": list(memory["line"])}


class WrongClock(Fault):
    """The loop runs at another rate than its time stamps say: `ratio` real seconds pass for one that is written."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Let every physics step take so much longer."""
        model.opt.timestep *= self.values["ratio"]


class CountingClock(WrongClock):
    """The same clock, and speeds that were taken from the angles with its time stamps."""

    distorts = True
    reading = "speeds by the same clock"

    def observe(self, plant: Plant, qpos: Array, qvel: Array) -> tuple[Array, Array]:
        """More seconds passed than were counted, so speeds look higher."""
        return qpos, qvel * self.values["ratio"]


def _servos(model: mujoco.MjModel, joint: str) -> list[int]:
    wanted = model.joint(joint).id
    moved = np.flatnonzero(model.actuator_trnid[:, 0] == wanted)
    return [int(i) for i in moved if model.actuator_biasprm[i, 1:3].any()]
