"""Faults of the surroundings: a tilted mount, air or water, wind, the ground."""

from __future__ import annotations

import mujoco
import numpy as np

from nfpde.bench.gap.faults.base import Fault


class Tilt(Fault):
    """The robot's base is turned about its x axis by `roll`, then about the fixed y axis by `pitch`."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Write gravity in the axes of the turned base."""
        roll, pitch = self.values["roll"], self.values["pitch"]
        cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
        about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        model.opt.gravity[:] = (about_y @ about_x).T @ model.opt.gravity


class Fluid(Fault):
    """The robot works in a denser or more viscous fluid."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Set both constants of the fluid."""
        model.opt.density, model.opt.viscosity = self.values["density"], self.values["viscosity"]


class Wind(Fault):
    """The fluid moves."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Set its velocity."""
        model.opt.wind[:] = self.values["velocity"]


class Slippery(Fault):
    """The ground and what stands on it slide on each other with another coefficient."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Change both sides: MuJoCo takes the larger of the two."""
        model.geom_friction[:, 0] = self.values["friction"]


class Soft(Fault):
    """A softer or livelier ground."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Change both sides: MuJoCo mixes the two."""
        model.geom_solref[:] = (self.values["time_constant"], self.values["damping_ratio"])


class Raised(Fault):
    """The ground is `height` above where the model has it."""

    def alter(self, model: mujoco.MjModel) -> None:
        """Lift the plane."""
        model.geom_pos[model.geom("floor").id, 2] += self.values["height"]
