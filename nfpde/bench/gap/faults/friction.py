"""Dry friction in a joint, by a law of speed and load, without any slip that a smoothed law would have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from nfpde.bench.gap.faults.base import Fault, dof_of

if TYPE_CHECKING:
    from nfpde.bench.gap.plant import Plant


class DryFriction(Fault):
    """The joint is held as long as `budget` suffices to stop it within the physics step; else it is slowed by it."""

    def budget(self, plant: Plant, dof: int) -> float:
        """Largest friction at present [Nm or N]."""
        return self.values["torque"]

    def resist(self, plant: Plant) -> None:
        """Exert what would stop the joint by the end of the step, at most the budget."""
        model, data = plant.model, plant.data
        dof = dof_of(model, self.target)
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fwdAcceleration(model, data)
        mujoco.mj_fwdConstraint(model, data)
        unit, answer = np.zeros((1, model.nv)), np.zeros((1, model.nv))
        unit[0, dof] = 1
        mujoco.mj_solveM(model, data, answer, unit)
        mobility, dt = answer[0, dof], model.opt.timestep
        drag = dt * mobility * _damping(model, dof)  # the integrator takes damping at the end of the step
        stop = -(data.qvel[dof] * (1 + drag) / dt + data.qacc[dof]) / mobility
        limit = self.budget(plant, dof)
        data.qfrc_applied[dof] += float(np.clip(stop, -limit, limit))


class Stribeck(DryFriction):
    """More friction at rest and near it than in motion."""

    def budget(self, plant: Plant, dof: int) -> float:
        """Falls from `static` to `coulomb` like a Gaussian of the speed."""
        low, high = self.values["coulomb"], self.values["static"]
        return low + (high - low) * float(np.exp(-((plant.data.qvel[dof] / self.values["speed"]) ** 2)))


class LoadFriction(DryFriction):
    """A gear that rubs more the more torque it transmits."""

    def budget(self, plant: Plant, dof: int) -> float:
        """A constant part and a share of the drive's torque at the joint."""
        return self.values["base"] + self.values["share"] * abs(float(plant.data.qfrc_actuator[dof]))


def _damping(model: mujoco.MjModel, dof: int) -> float:
    total = float(model.dof_damping[dof])
    for i in range(model.nactuator):
        if model.jnt_dofadr[model.actuator_trnid[i, 0]] == dof:
            total -= float(model.actuator_biasprm[i, 2]) * float(model.actuator_gear[i, 0]) ** 2
    return total
