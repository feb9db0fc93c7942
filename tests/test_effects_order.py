"""Effects before a physics step act in an order of their own, whatever order they are listed in."""

from itertools import permutations

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.sim import MujocoSimulator
from tests.models import load, make_windows, with_arrays

WHEEL = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="axle" axis="0 0 1" {joint}/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.2"/>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""
MOTOR, SERVO = '<motor joint="axle"/>', '<position joint="axle" kp="20" kv="0.7"/>'
INERTIA = 0.2

LINE = ("torque_speed", "#0", {"no_load_speed": (0.1, 1e3), "stall_torque": (0.1, 1e3)}, [3.0, 1.0])
LOAD = ("load_friction", "axle", {"base": (0, 1), "share": (0, 1)}, [0.05, 0.3])
PLAY = ("backlash", "#0", {"width": (0, 1)}, [0.3])
GEARED = ("backlash_geared", "#0", {"width": (0, 1)}, [0.3])
ZONE = ("dead_zone", "#0", {"half_width": (0, 1)}, [0.1])
GATE = ("dead_zone_gate", "#0", {"half_width": (0, 1)}, [0.1])
STRIBECK = ("stribeck_friction", "axle", {"coulomb": (0, 5), "static": (0, 5), "speed": (0.01, 1)}, [0.3, 0.6, 0.1])
SPRING = ("joint_spring", "axle", {"stiffness": (0, 50), "rest": (-1, 1)}, [2.0, 0.1])


def moved(listed, ctrl, actuator=MOTOR, joint='armature="0.05"'):
    """States (S, 2) of the wheel from rest under commands (S,), with effects in the order in which they are listed."""
    effects = [effect(name, target, **bounds) for name, target, bounds, _ in listed]
    sim = MujocoSimulator(load(WHEEL.format(joint=joint, actuator=actuator)), None, effects, check_influence=False)
    windows = make_windows(sim.model, 1, len(ctrl), history=sim.history_steps(0.001))
    windows = with_arrays(
        windows, state=np.zeros_like(windows.state), ctrl=ctrl[None, :, None], history=np.zeros_like(windows.history)
    )
    return sim.predict([[v for *_, values in listed for v in values]], windows)[0, 0]


THERE_AND_BACK = 5.0 * np.sign(np.sin(np.arange(600) / 60))


@pytest.mark.parametrize("actuator", [MOTOR, SERVO], ids=["motor", "servo"])
@pytest.mark.parametrize(
    "together",
    [
        (LINE, LOAD),
        (LINE, PLAY),
        (PLAY, ZONE),
        (PLAY, GATE),
        (ZONE, GATE),
        (PLAY, LOAD),
        (GEARED, STRIBECK),
        (GEARED, LOAD),
        (LINE, ZONE, LOAD),
        (SPRING, STRIBECK, GEARED),
    ],
    ids=lambda listed: "-".join(name for name, *_ in listed),
)
def test_the_order_in_the_list_does_not_matter(together, actuator):
    """Bit by bit."""
    ctrl = THERE_AND_BACK if actuator == MOTOR else 0.1 * THERE_AND_BACK
    orders = [moved(listed, ctrl, actuator) for listed in permutations(together)]
    assert np.abs(orders[0]).max() > 0.1
    for other in orders[1:]:
        np.testing.assert_array_equal(other, orders[0])


@pytest.mark.parametrize("listed", [(LINE, LOAD), (LOAD, LINE)], ids=["line first", "load first"])
def test_load_friction_is_of_the_torque_that_the_motor_has(listed):
    """A motor told to give 10 Nm gives 1 - v / 3 of its 1 Nm, of which the gear keeps 0.3 and 0.05 Nm more.

    I dv/dt = 0.7 (1 - v / 3) - 0.05 from rest: v = w (1 - exp(-0.7 t / (3 I))) with w = 3 (1 - 0.05 / 0.7).
    """
    speed = moved(listed, np.full(600, 10.0), joint="")[:, 1]
    t, rate = 0.001 * np.arange(1, 601), 0.7 / (3 * INERTIA)
    expected = 3 * (1 - 0.05 / 0.7) * -np.expm1(-rate * t)
    # Euler's first order, half a step, and a friction that gives way a little
    np.testing.assert_allclose(speed, expected, atol=0.02 * expected.max())


@pytest.mark.parametrize("listed", [(GEARED, STRIBECK), (STRIBECK, GEARED)], ids=["play first", "friction first"])
def test_friction_on_the_rotors_side_leaves_the_joint_free(listed):
    """In the play of a geared rotor the wheel coasts, however its friction is said."""
    name, target, bounds, _ = STRIBECK
    listed = [(name, target, bounds, [0.5, 0.5, 0.1]) if e is STRIBECK else e for e in listed]
    speed = moved(listed, np.where(np.arange(260) < 200, 5.0, -5.0))[:, 1]
    assert speed[199] == pytest.approx(0.2 * (5.0 - 0.5) / (INERTIA + 0.05), rel=0.02)
    np.testing.assert_allclose(speed[205:240], speed[210], atol=1e-9)
