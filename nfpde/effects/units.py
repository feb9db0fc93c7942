"""Units of effects on slides, which the vocabulary gives for hinges."""

from __future__ import annotations

import mujoco
import numpy as np

from nfpde.effects.drive import driven_joint
from nfpde.effects.effect import Effect

LINEAR = {
    "rad": "m",
    "rad/s": "m/s",
    "Nm": "N",
    "Nm/rad": "N/m",
    "Nms/rad": "Ns/m",
    "kg m2": "kg",
}
"""The unit along a slide of what has a unit about a hinge."""


def slides(model: mujoco.MjModel, effect: Effect) -> bool:
    """Whether an effect acts on slides alone, or on actuators of slides."""
    if effect.kind not in ("joint", "actuator"):
        return False
    ids = effect.bind(model).ids
    joints = ids if effect.kind == "joint" else np.array([driven_joint(model, int(i)) for i in ids], dtype=np.intp)
    slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
    return bool(len(joints)) and all(j >= 0 and int(model.jnt_type[j]) == slide for j in joints)
