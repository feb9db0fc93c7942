"""A base that does not stand level."""

import mujoco
import numpy as np

from nfpde.effects.effect import Array, Bounds, Effect, Quantity
from nfpde.effects.registry import register
from nfpde.effects.scales import DataScales


@register
class GravityTilt(Effect):
    """Gravity turned, as the base sees it when it is rolled about x, then pitched about y: MuJoCo's `opt.gravity`."""

    name = "gravity_tilt"
    kind = None
    whole = "world"
    quantities = (
        Quantity("roll", "rad", -np.pi, np.pi, neutral=0.0),
        Quantity("pitch", "rad", -np.pi, np.pi, neutral=0.0),
    )
    sentence = "The base is not level: gravity comes from another direction than in the model."
    confounders = ("joint_offset", "com_shift", "external_force", "actuator_bias")

    @classmethod
    def bounds_for(cls, model: mujoco.MjModel, element: int, scales: DataScales) -> Bounds | None:
        """Up to 20 degrees, where there is gravity."""
        if not model.opt.gravity.any():
            return None
        return {"roll": (-0.35, 0.35), "pitch": (-0.35, 0.35)}

    def screened(self, scales: DataScales) -> Array:
        """Three degrees about both axes."""
        return 0.05 * np.eye(2)

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Turn gravity."""
        roll, pitch = float(values[0]), float(values[1])
        if roll == 0.0 and pitch == 0.0:
            return
        about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        model.opt.gravity[:] = (about_y @ about_x).T @ model.opt.gravity
