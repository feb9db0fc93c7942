"""Twelve joints of a Unitree Go2 held in the air, after github.com/iit-DLSLab/sim2real-robot-identification (BSD-3)."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np

from nfpde.dataset import Dataset, Episode, resample_episode
from nfpde.dataset.velocities import differentiated


def quadruped(folder: Path, control_dt: float = 0.005, *, contacts: bool = False) -> tuple[mujoco.MjModel, Dataset]:
    """The robot as servos of the published gains, and a chirp of 23 s on all joints; speeds by differences.

    Args:
        folder: of `go2_dls.xml` and `go2_traj_0.npz` (`time`, `dof_pos`, `des_dof_pos`).
        control_dt: control step to resample to [s].
        contacts: let its hips, which overlap with its trunk, be pushed away by it; MuJoCo ignores them only while the
            trunk floats.
    """
    text = (folder / "go2_dls.xml").read_text(encoding="utf-8")
    gone = r"<mesh [^>]*/>|<geom[^>]*\bmesh=[^>]*/>|<freejoint/>|<sensor>.*?</sensor>|<keyframe>.*?</keyframe>"
    text = re.sub(gone, "", text, flags=re.DOTALL)
    text = re.sub(r"<motor class=\"\w+\" (name=\"\w+\" joint=\"\w+\")/>", r'<position \1 kp="20" kv="1.5"/>', text)
    text = text.replace("<option ", '<option timestep="0.005" integrator="implicitfast" ')
    if not contacts:
        text = text.replace('<geom friction="0.6"', '<geom contype="0" conaffinity="0" friction="0.6"')
    with np.load(folder / "go2_traj_0.npz") as file:
        time, q, wanted = (file[name].astype(float) for name in ("time", "dof_pos", "des_dof_pos"))
    whole = Episode("chirp", time, q, np.zeros_like(q), wanted)
    # nobody measured speeds: they are taken from the positions on the even clock, which the data set says
    return mujoco.MjModel.from_xml_string(text), differentiated(Dataset([resample_episode(whole, control_dt)]))
