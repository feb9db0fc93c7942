"""A cart on a rail and drawn states of it, for tests of what is predicted and kept."""

import mujoco
import numpy as np

from nfpde.dataset import Dataset, Episode

HORIZON = 3


def cart(mass=1):
    """One slide with a motor."""
    return mujoco.MjModel.from_xml_string(f"""
<mujoco><option timestep="0.01"/><worldbody><body name="cart"><joint name="slide" type="slide" axis="1 0 0"/>
<geom size=".1" mass="{mass}"/></body></worldbody><actuator><motor joint="slide"/></actuator></mujoco>
""")


def cart_windows():
    """Nine windows of states and commands that have nothing to do with each other."""
    rng = np.random.default_rng(0)
    rows = 30
    qpos, qvel, ctrl = rng.normal(size=(3, rows, 1))
    data = Dataset([Episode("only", 0.01 * np.arange(rows), qpos, qvel, ctrl)])
    return data.windows(HORIZON, stride=HORIZON, history=2)
