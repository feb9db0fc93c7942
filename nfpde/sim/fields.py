"""The numeric fields of an mjModel by name, options among them: `body_mass`, `opt.gravity`."""

from __future__ import annotations

from typing import Any

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray


def get_field(model: mujoco.MjModel, name: str) -> NDArray[Any]:
    """A live view of an mjModel field, or of an mjOption field for `opt.<name>`; a scalar option has shape ()."""
    if name.startswith("opt."):
        return np.asarray(getattr(model.opt, name[4:]))
    return getattr(model, name)


def set_field(model: mujoco.MjModel, name: str, value: NDArray[Any]) -> None:
    """Copy a value into a field of `get_field`."""
    if name.startswith("opt.") and np.ndim(value) == 0:
        setattr(model.opt, name[4:], value.item())
    else:
        get_field(model, name)[...] = value


def array_fields(model: mujoco.MjModel) -> list[str]:
    """Fields that decide how the model moves, by name; neither pictures and meshes nor what names them."""
    skip = ("tex", "mesh", "hfield", "skin", "mat_", "light", "cam", "name", "key_", "flex", "plugin")
    names = [f for f in mujoco.batch.MODEL_FIELDS if not f.startswith(skip)]
    return [f for f in names if isinstance(get_field(model, f), np.ndarray)]
