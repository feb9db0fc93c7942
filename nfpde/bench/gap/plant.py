"""The robot that is recorded: a model with its true constants, faults, and a loop over physics steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.bench.gap.faults.base import Fault

Array = NDArray[np.float64]
Base = Mapping[tuple[str, str], float]
"""Constants of the robot that differ from the model file: (field, element) to value."""

ALONE = "body_mass alone"
"""The field of a mass whose body keeps its inertia."""


@dataclass(frozen=True)
class Moment:
    """Everything that decides how a plant goes on."""

    qpos: Array
    qvel: Array
    warmstart: Array
    time: float
    memories: tuple[dict[str, Any], ...]

    def without(self, number: int) -> Moment:
        """The same moment of a robot that lacks the fault of that number."""
        return replace(self, memories=self.memories[:number] + self.memories[number + 1 :])


class Plant:
    """A robot with faults.

    Args:
        xml: the model as its user knows it.
        control_dt: time between two commands [s].
        base: true constants where they differ from the model's: `body_mass` (with the inertia), `ALONE` (without) and
            `dof_damping`.
        faults: faults, in the order in which they touch commands and readings.
    """

    def __init__(self, xml: str, control_dt: float, base: Base | None = None, faults: Sequence[Fault] = ()) -> None:
        spec = mujoco.MjSpec.from_string(xml)
        for fault in faults:
            fault.build(spec)
        self.model = spec.compile()
        self.nstep = round(control_dt / self.model.opt.timestep)
        self.faults = list(faults)
        set_base(self.model, base or {})
        for fault in faults:
            fault.alter(self.model)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_setConst(self.model, self.data)
        mujoco.mj_resetData(self.model, self.data)

    def begin(self, qpos: Array, qvel: Array, ctrl: Array) -> None:
        """Start an episode at qpos (nq,), qvel (nv,) after `ctrl` (nu,) has been commanded for long."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, self.data)
        for fault in self.faults:
            fault.begin(self, ctrl)

    def advance(self, ctrl: Array) -> None:
        """Take the physics steps of one command (nu,)."""
        if not self.faults:
            self.data.ctrl[:] = ctrl
            mujoco.mj_step(self.model, self.data, self.nstep)
            return
        for _ in range(self.nstep):
            self._step(ctrl)

    def _step(self, ctrl: Array) -> None:
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        for fault in self.faults:
            ctrl = fault.command(self, ctrl)
        data.ctrl[:] = ctrl
        data.qfrc_applied[:] = 0
        data.xfrc_applied[:] = 0
        for fault in self.faults:
            fault.push(self)
        for fault in self.faults:
            fault.resist(self)
        mujoco.mj_step2(model, data)
        for fault in self.faults:
            fault.after(self)

    def reading(self) -> tuple[Array, Array]:
        """What the sensors show without noise: qpos (nq,) and qvel (nv,)."""
        qpos, qvel = self.data.qpos.copy(), self.data.qvel.copy()
        for fault in self.faults:
            qpos, qvel = fault.observe(self, qpos, qvel)
        return qpos, qvel

    def save(self) -> Moment:
        """The present moment."""
        data = self.data
        memories = tuple(fault.remember() for fault in self.faults)
        return Moment(data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy(), data.time, memories)

    def load(self, moment: Moment, dq: Array | None = None, dv: Array | None = None) -> None:
        """Go back to a moment, disturbed by a measurement error in tangent space, dq and dv (nv,)."""
        data = self.data
        data.qpos[:], data.qvel[:], data.time = moment.qpos, moment.qvel, moment.time
        data.qacc_warmstart[:] = moment.warmstart
        for fault, memory in zip(self.faults, moment.memories, strict=True):
            fault.recall(memory)
        if dq is not None and dv is not None:
            mujoco.mj_integratePos(self.model, data.qpos, dq, 1.0)
            data.qvel[:] += dv
            for fault in self.faults:
                fault.disturb(self, dq, dv)

    def put(self, qpos: Array, qvel: Array) -> None:
        """Set the state alone, as for a prediction from a measured state."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel


def set_base(model: mujoco.MjModel, base: Base) -> None:
    """Write true constants into a compiled model."""
    for (field, name), value in base.items():
        if field in ("body_mass", ALONE):
            body = model.body(name).id
            if field == "body_mass":
                model.body_inertia[body] *= value / model.body_mass[body]
            model.body_mass[body] = value
        elif field == "dof_damping":
            model.dof_damping[model.joint(name).dofadr[0]] = value
        else:
            raise ValueError(f"no rule for the constant {field!r}; known are body_mass, {ALONE} and dof_damping")
