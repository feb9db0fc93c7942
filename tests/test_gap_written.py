"""How values with intervals and units are written."""

import math

import mujoco
import pytest

from nfpde.gap.report import Fitted
from nfpde.gap.written import channel_unit, joint_unit, with_interval

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco>
  <worldbody>
    <body name="base"><freejoint name="root"/><geom size=".1" mass="1"/>
      <body><joint name="rail" type="slide"/><geom size=".1" mass="1"/></body>
      <body><joint name="knee"/><geom size=".1" mass="1"/></body>
      <body><joint name="a.x"/><geom size=".1" mass="1"/></body>
      <body><joint type="ball"/><geom size=".1" mass="1"/></body>
    </body>
  </worldbody>
</mujoco>
""")


@pytest.mark.parametrize(
    ("value", "low", "high", "written"),
    [
        (0.09541, 0.0867, 0.1041, ("0.0954", "0.0867 to 0.1041")),
        (0.511, 0.0, 15.53, ("0.5", "0 to 15.5")),
        (1.955e-9, -0.375, 0.375, ("0", "-0.38 to 0.38")),
        (-4.1e-16, -0.25, 0.25, ("0", "-0.25 to 0.25")),
        (0.6, 0.591, 0.609, ("0.6000", "0.5910 to 0.6090")),
        (5123.4, 4100.0, 6100.0, ("5100", "4100 to 6100")),
        (3.2e7, 3.1e7, 3.3e7, ("3.20e+07", "3.10e+07 to 3.30e+07")),
        (2.34e-6, 2.1e-6, 2.5e-6, ("2.34e-06", "2.10e-06 to 2.50e-06")),
        (0.012345678, 0.012345678, 0.012345678, ("0.01235", "0.01235 to 0.01235")),
        (0.0954123456789, 0.0954123456787, 0.0954123456791, ("0.09541235", "0.09541235 to 0.09541235")),
        (1.5, math.nan, math.inf, ("1.5", "– to –")),
    ],
)
def test_values_are_as_precise_as_their_intervals(value, low, high, written):
    """Two digits of the interval's half, in the value and both ends; what rounds to nothing is zero, without a sign."""
    assert with_interval(Fitted(value, low, high, "m")) == written


def test_units_are_those_of_the_joint():
    """Slides in metres, hinges in radians, free joints by axis; a dot in a joint's own name is none of theirs."""
    for joint, unit in (("rail", "m"), ("knee", "rad"), ("root.x", "m"), ("root.rx", "rad"), ("a.x", "rad")):
        assert joint_unit(MODEL, joint) == unit
    assert channel_unit(MODEL, "qpos rail") == "m"
    assert channel_unit(MODEL, "qvel rail") == "m/s"
    assert channel_unit(MODEL, "qvel root.rz") == channel_unit(MODEL, "qvel #4.ry") == "rad/s"
    assert channel_unit(MODEL, "qpos root.z") == "m"
